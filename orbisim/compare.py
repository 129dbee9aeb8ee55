"""A/B: the same initial states and controls through two backends."""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from orbisim import metrics, plugins
from orbisim.agreement import PERSISTS, EngineWarning, faults_of_rollout
from orbisim.backend import Backend, Intervals
from orbisim.coverage import Coverage, coverage
from orbisim.episodes import Episodes, check_size, episodes, random_initial_states
from orbisim.errors import InputError
from orbisim.files.writing import make_folder, write_json
from orbisim.host.progress import track
from orbisim.metrics import Energies
from orbisim.penetration import Penetration, penetration
from orbisim.registry import make_backend
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.trajectory import Trajectory

Floats = npt.NDArray[np.float64]
SCHEMA = "orbisim.compare/1"
_POINTS = 200
"""Times at which errors are reported: more than a curve of the report has pixels for."""
_CHUNKS = 20
"""Parts of a rollout, between which the progress bar moves."""


@dataclasses.dataclass(frozen=True)
class Side:
    """One side of a comparison.

    Attributes:
      backend: name of the backend.
      trajectory: of all episodes.
      energies: energy and contacts at the reported times.
      penetration: of bodies in each other, at these times.
      intervals: how far off the backend says that it may be, at these times; None if it does not.
      steps_per_s: control steps of all worlds together for each second of wall-clock time.
      latency_s: wall-clock time of one step of a single world.
      control_step_s: duration of a control step.
      faults: what is wrong with the backend in the first steps, in words (`orbisim.agreement`).
    """

    backend: str
    trajectory: Trajectory
    energies: Energies
    penetration: Penetration
    intervals: Intervals | None
    steps_per_s: float
    latency_s: float
    control_step_s: float
    faults: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Result of `compare`.

    Attributes:
      scene: the scene. source: as the user named it.
      a, b: the two sides.
      horizon_s: [T] times of the reported errors, from the start of an episode.
      error: for each signal group [episodes, T], b against a.
      intervals: of each side that predicts intervals (`a`, `b`) these beside its true errors,
        which are its distance from the other side.
      rounding: the same errors between C MuJoCo and C MuJoCo started from the state rounded to
        float32: what no float32 engine can be expected to beat. None where not computed.
      seed: of initial states and controls.
    """

    scene: Scene
    source: str
    a: Side
    b: Side
    horizon_s: Floats
    error: Mapping[str, Floats]
    intervals: Mapping[str, Coverage]
    rounding: Mapping[str, Floats] | None
    seed: int

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return self.a.trajectory.nworld

    @property
    def diverged(self) -> int:
        """Number of episodes in which either side became non-finite."""
        lost = (self.a.trajectory.diverged_at >= 0) | (self.b.trajectory.diverged_at >= 0)
        return int(lost.sum())

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with either backend in the first steps, in words."""
        return (*self.a.faults, *self.b.faults)

    @property
    def worst_episode(self) -> int:
        """The episode with the largest error relative to the median of its group."""
        score = np.zeros(self.episodes)
        for values in self.error.values():
            finite = np.nan_to_num(values, nan=np.inf, posinf=np.inf)
            level = np.median(finite) or 1.0
            worst = finite.max(axis=1)  # infinite before it is divided by an infinite median
            score = np.maximum(score, np.where(np.isfinite(worst), worst, 1.0) / level)
            score[~np.isfinite(worst)] = np.inf
        score[(self.b.trajectory.diverged_at >= 0) | (self.a.trajectory.diverged_at >= 0)] = np.inf
        return int(score.argmax())

    def to_json(self) -> dict[str, Any]:
        """The comparison as contracts.md, section 1, has it."""
        units = metrics.layout(self.scene.model).units
        return {
            "schema": SCHEMA,
            "scene": self.source,
            "episodes": self.episodes,
            "seed": self.seed,
            "a": _side_json(self.a),
            "b": _side_json(self.b),
            "horizon_s": [float(t) for t in self.horizon_s],
            "error": {
                group: _summary(values, units[group]) for group, values in self.error.items()
            },
            "rounding": None
            if self.rounding is None
            else {g: _summary(values, units[g]) for g, values in self.rounding.items()},
            "energy": {"unit": "J", "a": _energy_json(self.a), "b": _energy_json(self.b)},
            "penetration": {
                "unit": "m",
                "a": self._penetration_json(self.a),
                "b": self._penetration_json(self.b),
            },
            "uncertainty": {
                side: found.to_json() if found else None
                for side, found in (("a", self.intervals.get("a")), ("b", self.intervals.get("b")))
            },
            "contacts": {
                name: metrics.quantiles(side.energies.contacts.astype(float), (0.5,))[0]
                for name, side in (("a", self.a), ("b", self.b))
            },
            "diverged": self.diverged,
            "worst_episode": self.worst_episode,
            "faults": list(self.faults),
        }

    def _penetration_json(self, side: Side) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for group, depth in side.penetration.depth.items():
            median, p95, worst = map(_no_nan, metrics.quantiles(depth, (0.5, 0.95, 1.0)))
            deepest = side.penetration.deepest[group]
            found[group] = {"median": median, "p95": p95, "worst": worst, "deepest": None}
            if deepest is not None:
                found[group]["deepest"] = {
                    "depth": deepest.depth,
                    "between": list(deepest.between),
                    "episode": deepest.world,
                    "time_s": float(self.horizon_s[deepest.step]),
                }
        return found

    def report(self, folder: str | Path, *, video: bool = True, renderer: str = "mujoco") -> Path:
        """Writes `report.html` and `report.json` into a folder; returns the path of the page.

        Args:
          folder: where to. video: whether the page shows one.
          renderer: of the video; one other than MuJoCo's is shown beside it.
        """
        folder = make_folder(folder)
        write_json(folder / "report.json", self.to_json())
        write_report = plugins.load("orbisim.reports", "compare", "report")
        page: Path = write_report(self, folder / "report.html", video=video, renderer=renderer)
        return page


def compare(
    scene: str | Scene | Episodes,
    a: str | Backend = "mujoco",
    b: str | Backend = "warp",
    *,
    count: int = 16,
    horizon: float | None = None,
    seed: int = 0,
    device: str | None = None,
    rounding: bool = True,
) -> Comparison:
    """Runs the same episodes through two backends.

    Args:
      scene: a path or task name, a scene, or episodes with initial states of their own.
      a: name or object of the backend that is the reference. An object that has a scene keeps it
        (a changed one, say), one that has none is given `scene`.
      b: name or object of the other backend; likewise.
      count: number of episodes.
      horizon: duration of each, s; that of the task, or 2 s, if None.
      seed: of initial states and controls.
      device: where backends given by name compute.
      rounding: whether to compute `Comparison.rounding`.

    Warns:
      EngineWarning: a classical backend stands still, or does not move as C MuJoCo does from the
        same states, in the first steps (`Comparison.faults`).

    Raises:
      InputError: no episodes, no horizon, control steps that do not fit together, or an object
        with a scene of other sizes.
    """
    if count < 1 or (horizon is not None and not 0 < horizon < math.inf):
        raise InputError(f"need at least one episode and a horizon above 0; got {count}, {horizon}")
    source = scene if isinstance(scene, str) else _source(scene)
    setup = _setup(scene, count, seed)
    sides = [_backend(name, setup, device) for name in (a, b)]
    step = _common_step(*sides)
    check_size(setup.scene.model, 2 * count, (horizon or setup.horizon) / step)
    controls = setup.controls(horizon or setup.horizon, step, seed)
    runs = [_run(backend, setup.initial, controls, step) for backend in sides]
    every = _thin(controls.shape[1])
    ra, rb = (
        _side(backend, run, step, setup, every) for backend, run in zip(sides, runs, strict=True)
    )
    for fault in (*ra.faults, *rb.faults):
        warnings.warn(fault, EngineWarning, stacklevel=2)
    error = _errors(setup.scene, ra.trajectory, rb.trajectory, every)
    rounded = _rounding(setup, controls, step, every) if rounding else None
    times: Floats = np.arange(1.0, controls.shape[1] + 1)[every] * step
    covered = {
        name: coverage(setup.scene.model, side.intervals, _at(side, every), _at(other, every))
        for name, side, other in (("a", ra, rb), ("b", rb, ra))
        if side.intervals is not None
    }
    return Comparison(setup.scene, source, ra, rb, times, error, covered, rounded, seed)


def _source(scene: Scene | Episodes) -> str:
    return scene.source if isinstance(scene, Scene) else scene.scene.source


def _setup(scene: str | Scene | Episodes, count: int, seed: int) -> Episodes:
    if isinstance(scene, Episodes):
        return scene
    if isinstance(scene, str):
        return episodes(scene, count, seed)
    return Episodes(scene, random_initial_states(scene.model, count, seed))


def _backend(backend: str | Backend, setup: Episodes, device: str | None) -> Backend:
    if isinstance(backend, Backend):
        return _loaded(backend, setup.scene)
    short = backend.partition(":")[0]
    return make_backend(
        backend,
        setup.scene,
        nworld=setup.initial.nworld,
        device=None if short == "mujoco" else device,
    )


def _loaded(backend: Backend, scene: Scene) -> Backend:
    """A backend that has a scene keeps it: that may be what is to be compared."""
    try:
        own = backend.model
    except InputError:
        backend.load(scene)
        return backend
    sizes = [(model.nq, model.nv, model.na, model.nu) for model in (own, scene.model)]
    if sizes[0] != sizes[1]:
        raise InputError(
            f"backend {backend.name!r} has scene {backend.scene.name!r} with (nq, nv, na, nu) = "
            f"{sizes[0]}; scene {scene.name!r} has {sizes[1]}: load a scene of the same joints and "
            "actuators into it, or give its name instead of an object"
        )
    return backend


def _common_step(a: Backend, b: Backend) -> float:
    """Duration of one control step: the longer of the two backends' steps."""
    step = max(a.timestep, b.timestep)
    for backend in (a, b):
        ratio = step / backend.timestep
        if abs(ratio - round(ratio)) > 1e-6:
            raise InputError(
                f"backend {backend.name!r} advances {backend.timestep:g} s at a time, of which the "
                f"other's {step:g} s is not a multiple; they cannot be compared"
            )
    return step


class _Run(NamedTuple):
    """A trajectory, intervals, wall-clock time, latency of one step of one world, faults."""

    trajectory: Trajectory
    intervals: Intervals | None
    elapsed: float
    latency: float
    faults: tuple[str, ...]


def _run(backend: Backend, initial: State, controls: Floats, step: float) -> _Run:
    nstep = round(step / backend.timestep)
    first = backend.rollout(initial, controls[:, :PERSISTS], nstep=nstep, sensors=False)  # compiles
    started = time.perf_counter()
    pieces: list[Trajectory] = []
    state = initial
    chunks = np.array_split(np.arange(controls.shape[1]), min(_CHUNKS, controls.shape[1]))
    for chunk in track(chunks, f"backend {backend.name}"):
        piece = backend.rollout(state, controls[:, chunk], nstep=nstep, sensors=False)
        pieces.append(piece)
        state = piece.final
    elapsed = time.perf_counter() - started
    timesteps = round(step / float(backend.model.opt.timestep))
    intervals = [backend.intervals(piece) for piece in pieces]
    return _Run(
        join(initial, controls, pieces),
        _joined([part for part in intervals if part is not None]),
        elapsed,
        _latency(backend, initial, controls, nstep),
        faults_of_rollout(backend, first, timesteps),
    )


def _joined(parts: list[Intervals]) -> Intervals | None:
    """Those of consecutive rollouts; None for none."""
    if not parts:
        return None
    position, rotation = (
        np.concatenate([getattr(part, name) for part in parts], axis=1)
        for name in ("position", "rotation")
    )
    return dataclasses.replace(parts[0], position=position, rotation=rotation)


def _latency(backend: Backend, initial: State, controls: Floats, nstep: int) -> float:
    """Median time of one control step of a single world, s."""
    state, control = initial[0], controls[:1, 0]
    times: list[float] = []
    state = backend.step(state, control, nstep)
    for _ in range(20):
        started = time.perf_counter()
        backend.step(state, control, nstep)
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def join(initial: State, controls: Floats, pieces: list[Trajectory]) -> Trajectory:
    """One trajectory from consecutive ones; a world once lost stays lost."""
    starts = np.cumsum([0, *(piece.nstep for piece in pieces[:-1])])
    diverged_at = np.full(initial.nworld, -1)
    for start, piece in zip(starts, pieces, strict=True):
        new = (piece.diverged_at >= 0) & (diverged_at < 0)
        diverged_at[new] = start + piece.diverged_at[new]
    arrays = {
        name: np.concatenate([_host(getattr(piece, name)) for piece in pieces], axis=1)
        for name in ("time", "qpos", "qvel", "act")
    }
    for world in np.flatnonzero(diverged_at >= 0):
        for name in ("qpos", "qvel", "act"):
            arrays[name][world, diverged_at[world] :] = np.nan
    return Trajectory(
        initial=initial,
        control=controls,
        sensordata=None,
        diverged_at=diverged_at,
        final=pieces[-1].final,
        **arrays,
    )


def _host(array: Any) -> Floats:
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array, np.float64)


def _thin(steps: int) -> npt.NDArray[np.int64]:
    """At most `_POINTS` of the steps, the first and the last among them."""
    return np.unique(np.linspace(0, steps - 1, min(steps, _POINTS)).round().astype(int))


def _side(
    backend: Backend,
    run: _Run,
    step: float,
    setup: Episodes,
    every: npt.NDArray[np.int64],
) -> Side:
    trajectory = run.trajectory
    energies = metrics.energies(
        setup.scene.model, trajectory.qpos[:, every], trajectory.qvel[:, every]
    )
    speed = trajectory.nworld * trajectory.nstep / run.elapsed
    return Side(
        backend.name,
        trajectory,
        energies,
        penetration(setup.scene, trajectory.qpos[:, every]),
        _thinned(run.intervals, every),
        speed,
        run.latency,
        step,
        run.faults,
    )


def _thinned(intervals: Intervals | None, every: npt.NDArray[np.int64]) -> Intervals | None:
    if intervals is None:
        return None
    return dataclasses.replace(
        intervals,
        position=intervals.position[:, every],
        rotation=intervals.rotation[:, every],
    )


def _at(side: Side, every: npt.NDArray[np.int64]) -> Floats:
    """Its coordinates [nworld, T, nq] at the reported times."""
    return np.asarray(side.trajectory.qpos[:, every])


def _errors(
    scene: Scene, a: Trajectory, b: Trajectory, every: npt.NDArray[np.int64]
) -> dict[str, Floats]:
    where = metrics.layout(scene.model)
    return metrics.errors(
        where, a.qpos[:, every], a.qvel[:, every], b.qpos[:, every], b.qvel[:, every]
    )


def _rounding(
    setup: Episodes, controls: Floats, step: float, every: npt.NDArray[np.int64]
) -> dict[str, Floats]:
    """Errors between C MuJoCo and itself from an initial state rounded to float32."""
    reference = make_backend("mujoco", setup.scene, nworld=setup.initial.nworld)
    nstep = round(step / reference.timestep)
    rounded = setup.initial.replace(
        qpos=setup.initial.qpos.astype(np.float32).astype(np.float64),
        qvel=setup.initial.qvel.astype(np.float32).astype(np.float64),
    )
    exact, moved = (
        reference.rollout(state, controls, nstep=nstep, sensors=False)
        for state in (setup.initial, rounded)
    )
    return _errors(setup.scene, exact, moved, every)


def _summary(values: Floats, unit: str) -> dict[str, Any]:
    median, p95 = metrics.quantiles(values)
    return {"unit": unit, "median": _no_nan(median), "p95": _no_nan(p95)}


def _no_nan(values: list[float]) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values]


def _energy_json(side: Side) -> dict[str, Any]:
    """Of the total energy median and 95 %; the same of its kinetic part."""
    rows = []
    for values in (side.energies.total, side.energies.kinetic):
        median, p95 = metrics.quantiles(values)
        rows.append({"median": _no_nan(median), "p95": _no_nan(p95)})
    return {**rows[0], "kinetic": rows[1]}


def _side_json(side: Side) -> dict[str, Any]:
    return {
        "backend": side.backend,
        "steps_per_s": side.steps_per_s,
        "latency_s": side.latency_s,
        "control_step_s": side.control_step_s,
    }
