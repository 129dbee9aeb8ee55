"""`Duty`: what a policy is to do with a machine, in any scene of it."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from orbisim_policies.problem import Floats, Moment, Problem, Starts
from torch import Tensor

from orbisim.effects import EffectInstance
from orbisim.recording.joints import joints
from orbisim.scene import Scene, load_scene
from orbisim.vector.models import numbers
from orbisim.vector.randomization import Intervals

ASSETS = Path(__file__).parents[2] / "mjcf_assets"
SCENES = 32
"""Scenes that are drawn without a diagnosis, as many as `--randomize` draws with one."""


class Wide(NamedTuple):
    """An effect, and how widely its parameters are drawn without a diagnosis."""

    effect: str
    target: str
    ranges: Mapping[str, tuple[float, float]]


def span(effect: str, target: str, low: float, high: float, **fixed: float) -> Wide:
    """An effect whose first parameter, by the names of the catalogue, is drawn."""
    first = {"coulomb_friction": "torque", "payload": "mass", "torque_gain": "gain"}
    first |= {"sliding_friction": "coefficient", "backlash": "width", "actuator_delay": "delay"}
    ranges = {first[effect]: (low, high), **{n: (v, v) for n, v in fixed.items()}}
    return Wide(effect, target, ranges)


class Duty(Problem):
    """Episodes in a scene of a machine: as declared, with effects, or drawn from many.

    Coordinates are those of the declared joints: what effects add to a scene is not seen.

    Args:
      scene: of the machine; the declared one if None.
      seed: of the scenes that are drawn widely; none are if None.
      backend: that steps MuJoCo's scene: `mujoco`, `hybrid:PATH`.

    Attributes:
      asset: folder of the declared scene. effects: what it lacks.
      wide: what is drawn without a diagnosis; the machine is within.
      unit, scale: of `miss` in tables. goal: in words.
      columns: of the observation that a motion which is searched sees: what is asked for, and the
        time; policies are trained by PPO if None.
    """

    asset: str
    effects: tuple[EffectInstance, ...]
    wide: tuple[Wide, ...]
    unit: str
    scale: float
    goal: str
    columns: tuple[int, int] | None = None
    parts, sparse = ("reward",), False

    def __init__(
        self, scene: Scene | None = None, seed: int | None = None, backend: str = "mujoco"
    ) -> None:
        declared = self.declared()
        self.scene, self._backend = scene or declared, backend
        self._changes: dict[str, Floats] = {}
        if seed is not None:
            drawn = self._drawn(declared, seed)
            self.scene = drawn[0]
            self._changes = _changes([one.model for one in drawn])
        self._data = mujoco.MjData(self.scene.model)
        theirs = {joint.label: joint for joint in joints(self.scene.model)}
        mine = [theirs[joint.label] for joint in joints(declared.model)]
        self.q = torch.tensor([i for j in mine for i in range(j.q.start, j.q.stop)])
        self.v = torch.tensor([i for j in mine for i in range(j.v.start, j.v.stop)])

    @classmethod
    def declared(cls) -> Scene:
        """The scene as declared."""
        return load_scene(ASSETS / cls.asset / "scene.xml")

    @property
    def backend(self) -> str:
        """See `Problem.backend`."""
        return self._backend

    def _drawn(self, declared: Scene, seed: int) -> list[Scene]:
        middles = [
            EffectInstance(e, t, {n: (low + high) / 2 for n, (low, high) in ranges.items()})
            for e, t, ranges in self.wide
        ]
        every = Intervals(tuple(middles), tuple(one.ranges for one in self.wide))
        return [every.draw(declared, SCENES * seed + i) for i in range(SCENES)]

    # -- episodes ------------------------------------------------------------------------------

    @abc.abstractmethod
    def start(self, rng: np.random.Generator) -> tuple[Sequence[float], Sequence[float], Floats]:
        """Declared positions and velocities of an episode, and its command."""

    def draw(self, seeds: Sequence[int]) -> Starts:
        """See `Problem.draw`; the same start in every scene of the machine."""
        model, rows = self.scene.model, []
        params = np.zeros((len(seeds), 1 if self._changes else 0))
        qpos, qvel = np.tile(model.qpos0, (len(seeds), 1)), np.zeros((len(seeds), model.nv))
        for row, seed in enumerate(seeds):
            rng = np.random.default_rng([seed, 7])
            qpos[row, self.q], qvel[row, self.v], command = self.start(rng)
            rows.append(command)
            params[row] = rng.integers(SCENES)
        return Starts(qpos, qvel, np.zeros((len(seeds), model.nu)), np.array(rows), params)

    def write(self, model: mujoco.MjModel, params: Floats) -> None:
        """See `Problem.write`: one of the drawn scenes."""
        if not self._changes:
            return
        views = numbers(model)
        for name, rows in self._changes.items():
            views[name][...] = rows[int(params[0])]
        mujoco.mj_setConst(model, self._data)

    # -- functions of tensors ------------------------------------------------------------------

    @abc.abstractmethod
    def reward(self, memory: Tensor, q: Tensor, v: Tensor, control: Tensor) -> Tensor:
        """[N], up to 1, of declared coordinates."""

    @abc.abstractmethod
    def see(self, q: Tensor, v: Tensor, moment: Moment) -> Tensor:
        """[N, F] of declared coordinates."""

    @abc.abstractmethod
    def miss(self, starts: Starts, q: Tensor, value: Tensor) -> Tensor:
        """[N]: how far from the goal an episode ended, in SI units."""

    @abc.abstractmethod
    def good(self, q: Tensor, miss: Tensor) -> Tensor:
        """[N]: whether that is a success."""

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """[N, 1 + C]: the mean reward, and the command that the episode began with."""
        return torch.cat([qpos.new_zeros((len(qpos), 1)), command.to(qpos)], 1)

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """See `Problem.count`."""
        q, v = qpos[:, self.q], qvel[:, self.v]
        reward = self.reward(score[:, 1:], q, v, control) / self.steps
        return torch.cat([score[:, :1] + reward[:, None], score[:, 1:]], 1)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """The mean reward [N, 1]."""
        return score[:, :1]

    def observe(self, moment: Moment) -> Tensor:
        """See `Problem.observe`."""
        return self.see(moment.qpos[:, self.q], moment.qvel[:, self.v], moment).clamp(-8, 8)

    def missed(self, starts: Starts, qpos: Floats, value: Floats) -> Floats:
        """[N]: `miss` of an evaluation, in `unit`."""
        q = torch.as_tensor(qpos)[:, self.q]
        return np.asarray(self.scale * self.miss(starts, q, torch.as_tensor(value)).numpy())

    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """See `Problem.success`."""
        q = torch.as_tensor(qpos)[:, self.q]
        return {"success": self.good(q, self.miss(starts, q, torch.as_tensor(value))).numpy()}


def _changes(models: Sequence[mujoco.MjModel]) -> dict[str, Floats]:
    """By field: the values of models that differ in it, [models, ...]."""
    each = [numbers(model) for model in models]
    stacked = {name: np.stack([views[name] for views in each]) for name in each[0]}
    return {name: rows for name, rows in stacked.items() if (rows != rows[:1]).any()}
