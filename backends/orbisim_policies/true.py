"""Worlds stepped by C MuJoCo: where policies are evaluated, and where the baselines learn."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.registry import make_backend
from orbisim.scene import Scene
from orbisim.scene.texts import acts_between_timesteps
from orbisim.vector.mirrored import Mirrored
from orbisim.vector.models import ModelFields
from orbisim.vector.simulator import Threads
from orbisim_policies.problem import Floats, Moment, Problem, Starts

Ids = npt.NDArray[np.int64]


class TrueWorlds:
    """A problem's episodes in C MuJoCo, each world in a scene of its own.

    Args:
      problem: on the CPU.
      nworld: number of worlds.
      nthread: threads; 0 for one per usable core.
      nominal: whether observations have nominal values of what no image shows of a scene.

    Attributes:
      diverged: [nworld] how often each world has diverged.
      steps: control steps of all worlds so far.
    """

    def __init__(
        self, problem: Problem, nworld: int, nthread: int = 0, nominal: bool = False
    ) -> None:
        self.problem, self.nworld, self._nominal = problem, nworld, nominal
        model = problem.model
        self._working = copy.copy(model)
        self._fields = ModelFields(model, self._working, nworld)
        self._threads = self._stepped(nthread)
        self._data = mujoco.MjData(self._working)
        self._substeps = round(problem.timestep / model.opt.timestep)
        self.diverged: npt.NDArray[np.int64] = np.zeros(nworld, int)
        self.steps = 0
        self._command: Any = None
        self._params: Any = None
        self._score: Any = None
        self._done = torch.zeros(nworld)

    def _stepped(self, nthread: int) -> Threads:
        """C MuJoCo in threads; by a backend where the scene carries effects between timesteps, or
        the problem names another one."""
        model, backend = self.problem.model, self.problem.backend
        if backend == "mujoco" and not acts_between_timesteps(model):
            return Threads(model, self._fields, self.nworld, nthread=nthread)
        scene = Scene.from_model(model, source=self.problem.name)
        engine = make_backend(backend, scene, nworld=self.nworld)
        return Mirrored(engine, model, self._fields, self.nworld)

    def begin(self, worlds: Ids, starts: Starts) -> None:
        """Begins episodes in some worlds."""
        for world, row in zip(worlds, range(len(starts)), strict=True):
            self._fields.place(world)
            self.problem.write(self._working, starts.params[row])
            self._fields.take(world)
            mujoco.mj_resetData(self._working, self._data)
            self._data.qpos[:], self._data.qvel[:] = starts.qpos[row], starts.qvel[row]
            self._data.ctrl[:] = starts.ctrl[row]
            self._threads.set_world(world, self._data)
        if self._fields.varied:
            self._threads.set_models(worlds)
        if self._command is None:
            self._command = torch.zeros((self.nworld, starts.command.shape[1]))
            self._params = torch.zeros((self.nworld, starts.params.shape[1]))
        index = torch.as_tensor(worlds)
        self._command[index] = _float(starts.command)
        params = _float(starts.params)
        self._params[index] = self.problem.unseen(params) if self._nominal else params
        fields = (starts.qpos, starts.qvel, starts.command)
        score = self.problem.begin(*map(_float, fields))
        if self._score is None:
            self._score = torch.zeros((self.nworld, score.shape[1]))
        self._score[index] = score
        self._done[index] = 0.0

    @property
    def coordinates(self) -> tuple[Floats, Floats]:
        """qpos [nworld, nq] and qvel [nworld, nv], copies."""
        return np.array(self._threads.field("qpos")), np.array(self._threads.field("qvel"))

    @property
    def command(self) -> Tensor:
        """[nworld, C]: where actions have led what they command, a copy."""
        return torch.clone(self._command)

    @property
    def control(self) -> Floats:
        """[nworld, nu] of the last step, a copy."""
        return np.array(self._threads.ctrl)

    def observation(self) -> Tensor:
        """What the policy sees, [nworld, F]."""
        qpos, qvel = map(_float, self.coordinates)
        time = self._done / self.problem.steps
        moment = Moment(qpos, qvel, self._command, self._params, self._score, time)
        return self.problem.observe(moment)

    def step(self, action: Tensor, worlds: Ids | None = None) -> npt.NDArray[np.bool_]:
        """One control step; which worlds diverged, [nworld].

        Args:
          action: [nworld, A]. worlds: only these; all if None.
        """
        worlds = np.arange(self.nworld) if worlds is None else worlds
        control, command = self.problem.control(self._command, action)
        host = control.double().numpy()
        fine = np.isfinite(host).all(axis=1)
        self._threads.ctrl[worlds] = np.where(fine[:, None], host, 0.0)[worlds]
        lost = np.zeros(self.nworld, bool)
        lost[worlds] = self._threads.step(worlds, self._substeps) | ~fine[worlds]
        qpos, qvel = self.coordinates
        lost[worlds] |= ~np.isfinite(qpos[worlds]).all(axis=1)
        well = torch.as_tensor(worlds[~lost[worlds]])
        score = self.problem.count(self._score, _float(qpos), _float(qvel), control)
        self._score[well], self._command[well] = score[well], command[well]
        self._done[well] += 1
        self.diverged += lost
        self.steps += len(worlds)
        return lost

    def worth(self) -> Tensor:
        """[nworld, parts]: the value of the episodes if they end here."""
        return self.problem.value(self._score, _float(self.coordinates[0]))

    def measure(self) -> Tensor:
        """[nworld, parts]: what evaluations report."""
        return self.problem.measure(self._score, _float(self.coordinates[0]))

    @property
    def over(self) -> npt.NDArray[np.bool_]:
        """[nworld]: whose episode has come to its end."""
        return np.asarray(self._done.numpy() >= self.problem.steps)

    def state(self) -> dict[str, Tensor]:
        """All that episodes go on from but their scenes, by name."""
        return {
            "physics": torch.as_tensor(self._threads.physics),
            "command": self._command,
            "score": self._score,
            "done": self._done,
            "diverged": torch.as_tensor(self.diverged),
            "steps": torch.tensor(self.steps),
        }

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Takes what `state` gave, in worlds that were begun in the same scenes."""
        self._threads.physics = tensors["physics"].numpy()
        for name in ("command", "score", "done"):
            getattr(self, f"_{name}").copy_(tensors[name])
        self.diverged[:] = tensors["diverged"].numpy()
        self.steps = int(tensors["steps"])

    def close(self) -> None:
        """Frees the worlds."""
        self._threads.close()


def _float(values: Any) -> Tensor:
    return torch.as_tensor(np.asarray(values), dtype=torch.float32)
