"""Windows that are simulated side by side."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.freerun.jobs import Job, Run
from orbisim.freerun.nodes import Nodes, join
from orbisim.recording import initial
from orbisim.recording.interpolation import Between, linear, positions
from orbisim.state import State
from orbisim.trajectory import Trajectory

Floats = npt.NDArray[np.float64]

_NUMBERS = 8_000_000
"""Numbers that a rollout may return at once."""


class Batch:
    """Windows that are simulated side by side."""

    def __init__(self, backend: Backend, jobs: Sequence[Job]) -> None:
        self.backend, self.jobs, self.model = backend, jobs, backend.model
        self.step = backend.timestep
        self.start = np.array([job.time[0] for job in jobs])
        self.places = [Between((job.time - job.time[0]) / self.step) for job in jobs]
        self.sensors = self.model.nsensordata > 0 and any(
            np.isfinite(job.prepared.bound.sensordata).any() for job in jobs
        )
        extra = 2 if self.sensors else 1  # sensor data of a state come with the step after it
        self.steps = np.array([int(place.base[-1]) + extra for place in self.places])
        count = [len(job.rows) for job in jobs]
        self.found: dict[str, list[Floats]] = {
            name: [np.full((n, width), np.nan) for n in count]
            for name, width in self._widths().items()
        }
        self.diverged = np.zeros(len(jobs), bool)

    def run(self) -> list[Run]:
        """Simulates all windows to their ends."""
        with self._reporting():
            self._simulate()
        sensors: list[Any] = self.found.get("sensordata", [None] * len(self.jobs))
        return [
            Run(
                job.recording,
                job.rows,
                job.time,
                self.found["qpos"][i],
                self.found["qvel"][i],
                self.found["act"][i],
                sensors[i],
                bool(self.diverged[i]),
            )
            for i, job in enumerate(self.jobs)
        ]

    def _widths(self) -> dict[str, int]:
        widths = {"qpos": self.model.nq, "qvel": self.model.nv, "act": self.model.na}
        return widths | ({"sensordata": self.model.nsensordata} if self.sensors else {})

    @contextlib.contextmanager
    def _reporting(self) -> Iterator[None]:
        """Asks for sensor data while it runs, if they are compared and the backend has them."""
        before = self.backend.report
        if self.sensors and "sensordata" in self.backend.reportable:
            self.backend.report = before | {"sensordata"}
        try:
            yield
        finally:
            self.backend.report = before

    def _simulate(self) -> None:
        alive = np.arange(len(self.jobs))
        state, nodes = self._initial(), None
        done = 0
        while alive.size:
            left = int(self.steps[alive].max()) - done
            count = min(left, max(1, _NUMBERS // (len(alive) * self._numbers())))
            trajectory = self._advance(state, alive, done, count)
            nodes = Nodes(trajectory, nodes, done)
            self._collect(alive, nodes)
            lost = trajectory.diverged_at
            self.diverged[alive] |= (lost >= 0) & (lost < self.steps[alive] - done)
            done += count
            keep = (self.steps[alive] > done) & ~self.diverged[alive]
            state = trajectory.final.numpy()
            if not keep.all():
                state, nodes = state[np.flatnonzero(keep)], nodes.only(keep)
                alive = alive[keep]

    def _numbers(self) -> int:
        model = self.model
        return int(model.nq + model.nv + model.na + model.nu + model.nsensordata + 1)

    def _initial(self) -> State:
        state = self.backend.reset(len(self.jobs)).numpy()
        parts: dict[str, list[Floats]] = {"qpos": [], "qvel": [], "act": [], "history": []}
        order = _by_recording(self.jobs)
        for indices in order:
            one = self.jobs[indices[0]].prepared
            rows = np.array([self.jobs[i].rows.start for i in indices])
            parts["qpos"].append(one.states.qpos[rows])
            parts["qvel"].append(one.states.qvel[rows])
            parts["act"].append(initial.activations(one.bound, one.states, rows))
            parts["history"].append(initial.histories(one.bound, rows))
        back = np.argsort(np.concatenate(order))
        arrays = {name: np.concatenate(values)[back] for name, values in parts.items()}
        history = arrays.pop("history")
        state = state.replace(time=self.start, **arrays)
        return state.with_memory(history=history) if history.size else state

    def _advance(
        self, state: State, alive: npt.NDArray[np.int64], first: int, count: int
    ) -> Trajectory:
        means = [self.jobs[i].ctrl.means(self.start[i], self.step, first, count) for i in alive]
        controls = np.stack(means)
        if not any(self.jobs[i].force for i in alive):
            return self.backend.rollout(state, controls, sensors=self.sensors)
        forces = np.zeros((len(alive), count, self.model.nv))
        for row, i in enumerate(alive):
            force = self.jobs[i].force
            if force is not None:
                forces[row] = force.means(self.start[i], self.step, first, count)
        return self._advance_forced(state, controls, forces)

    def _advance_forced(self, state: State, controls: Floats, forces: Floats) -> Trajectory:
        """Step by step, as generalized forces change with every step."""
        pieces: list[Trajectory] = []
        current = state
        for t in range(controls.shape[1]):
            current = current.with_memory(qfrc_applied=forces[:, t])
            piece = self.backend.rollout(current, controls[:, t : t + 1], sensors=self.sensors)
            pieces.append(piece)
            current = piece.final.numpy()
        return join(state, controls, pieces)

    def _collect(self, alive: npt.NDArray[np.int64], nodes: Nodes) -> None:
        """Writes the states at the recorded times that the nodes surround."""
        for row, i in enumerate(alive):
            place = self.places[i]
            for name in self.found:
                values = nodes.values[name]
                if values is None:
                    continue
                first = nodes.first[name]
                here = (place.base >= first) & (place.base + 1 < first + values.shape[1])
                if here.any():
                    between = place[here]
                    low, high = between.base - first, between.base - first + 1
                    self.found[name][i][here] = (
                        self._positions(nodes, row, low, high, between.part)
                        if name == "qpos"
                        else linear(values[row, low], values[row, high], between.part)
                    )

    def _positions(
        self,
        nodes: Nodes,
        row: int,
        low: npt.NDArray[np.int64],
        high: npt.NDArray[np.int64],
        part: Floats,
    ) -> Floats:
        qpos, qvel = nodes.values["qpos"], nodes.values["qvel"]
        assert qpos is not None
        assert qvel is not None
        before, after = (qpos[row, low], qvel[row, low]), (qpos[row, high], qvel[row, high])
        return positions(self.model, before, after, part, self.step)


def _by_recording(jobs: Sequence[Job]) -> list[npt.NDArray[np.int64]]:
    """Numbers of the jobs of each recording, in the order of their rows."""
    found: dict[int, list[int]] = {}
    for index in sorted(range(len(jobs)), key=lambda i: jobs[i].rows.start):
        found.setdefault(jobs[index].recording, []).append(index)
    return [np.array(indices) for indices in found.values()]
