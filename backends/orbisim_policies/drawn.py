"""Episodes in scenes that have what a diagnosis has found, drawn from its intervals."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from orbisim.effects.carry import add_effects
from orbisim.errors import InputError
from orbisim.scene import Scene
from orbisim.tasks.sampling import stream
from orbisim.vector.models import numbers
from orbisim.vector.randomization import Intervals
from orbisim_policies.problem import Floats, Moment, Problem, Starts

SCENES = 32
"""Scenes that are drawn; each episode has one of them."""

_MASSES = ("body_mass", "body_inertia", "geom_size")
"""Fields to which effects add: of a body whose mass the task draws, they would add to nothing."""


class DrawnProblem(Problem):
    """A problem whose episodes have effects, with parameters drawn from intervals.

    What an effect changes replaces what the task itself declares or draws (the friction of a cube,
    say). A policy belongs to the problem's own scene, and does not see what was drawn.

    Args:
      problem: to which the effects are added.
      intervals: of the effects' parameters.
      seed: of what is drawn.
      count: number of scenes; `SCENES` if None.

    Raises:
      InputError: an effect does not fit the scene, adds joints to it, or changes the mass of a body
        whose mass the task draws.
    """

    def __init__(
        self, problem: Problem, intervals: Intervals, seed: int = 0, count: int | None = None
    ) -> None:
        self._problem, self._intervals, self._seed = problem, intervals, seed
        self._template, self._count = problem.template, count or SCENES
        scenes = [intervals.draw(self._template, _of(seed, i)) for i in range(self._count)]
        self._base = scenes[0]
        self._data = mujoco.MjData(self._base.model)
        self._changes = _changes(self._template.model, [scene.model for scene in scenes])
        self.name, self.scene, self.timestep = problem.name, problem.scene, problem.timestep
        self.steps, self.actions = problem.steps, problem.actions
        self.observations, self.parts = problem.observations, problem.parts
        self.sparse = problem.sparse
        self._check_masses()

    @property
    def template(self) -> Scene:
        """One of the drawn scenes: all have the same sizes."""
        return self._base

    @property
    def conditions(self) -> Mapping[str, Any]:
        """See `Problem.conditions`: the effects and their intervals."""
        pairs = zip(self._intervals.effects, self._intervals.ranges, strict=True)
        found = [
            {
                "effect": e.effect,
                "target": e.target,
                "intervals": {n: list(s) for n, s in r.items()},
            }
            for e, r in pairs
        ]
        return {"randomize": {"effects": found, "seed": self._seed, "scenes": self._count}}

    @property
    def alterations(self) -> Mapping[str, tuple[mujoco.MjModel, mujoco.MjModel]]:
        """See `Problem.alterations`: each effect alone, at the upper end of its intervals."""
        found = {}
        for effect, spans in zip(self._intervals.effects, self._intervals.ranges, strict=True):
            upper = effect.replace(**{n: high for n, (_, high) in spans.items()})
            altered = add_effects(self._template, [upper])
            name = f"{effect.effect} of {effect.target!r}"
            found[name] = (self._template.model, altered.model)
        return found

    def to(self, device: torch.device) -> DrawnProblem:
        """See `Problem.to`."""
        moved = copy.copy(self)
        moved._problem = self._problem.to(device)
        return moved

    def draw(self, seeds: Sequence[int]) -> Starts:
        """The problem's own, with the number of a drawn scene as the last parameter."""
        return self._numbered(self._problem.draw(seeds), seeds)

    def trials(self, count: int, seed: int) -> tuple[Scene, Starts]:
        """See `Problem.trials`: in one drawn scene."""
        scene, starts = self._problem.trials(count, seed)
        drawn = self._intervals.draw(scene, _of(self._seed, _number(seed, self._count)))
        return drawn, self._numbered(starts, [seed] * count)

    def write(self, model: mujoco.MjModel, params: Floats) -> None:
        """See `Problem.write`."""
        self._problem.write(model, params[:-1])
        views, number = numbers(model), int(params[-1])
        for name, (where, rows) in self._changes.items():
            views[name][where] = rows[number]
        mujoco.mj_setConst(model, self._data)

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """See `Problem.begin`."""
        return self._problem.begin(qpos, qvel, command)

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """See `Problem.count`."""
        return self._problem.count(score, qpos, qvel, control)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """See `Problem.value`."""
        return self._problem.value(score, qpos)

    def measure(self, score: Tensor, qpos: Tensor) -> Tensor:
        """See `Problem.measure`."""
        return self._problem.measure(score, qpos)

    def observe(self, moment: Moment) -> Tensor:
        """See `Problem.observe`; without what was drawn."""
        return self._problem.observe(moment._replace(params=moment.params[:, :-1]))

    def unseen(self, params: Tensor) -> Tensor:
        """See `Problem.unseen`."""
        return torch.cat([self._problem.unseen(params[:, :-1]), params[:, -1:]], 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """See `Problem.control`."""
        return self._problem.control(command, action)

    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """See `Problem.success`."""
        return self._problem.success(starts, qpos, value)

    def _numbered(self, starts: Starts, seeds: Sequence[int]) -> Starts:
        column = np.array([[float(_number(seed, self._count))] for seed in seeds])
        return dataclasses.replace(starts, params=np.append(starts.params, column, axis=1))

    def _check_masses(self) -> None:
        """Refuses effects on bodies whose mass the task draws."""
        model, views = self._template.model, numbers(self._template.model)
        working = copy.copy(model)
        drawn = {name: np.zeros(views[name].shape, bool) for name in _MASSES}
        for params in self._problem.draw(range(2)).params:
            self._problem.write(working, params)
            for name, flags in drawn.items():
                flags |= numbers(working)[name] != views[name]
        for name, (where, _) in self._changes.items():
            if name in drawn and drawn[name][where].any():
                kind = "geom" if name.startswith("geom") else "body"
                number = int(
                    np.flatnonzero((drawn[name] & where).reshape(len(where), -1).any(1))[0]
                )
                raise InputError(
                    f"{self.name}: an effect of the diagnosis changes {name} of {kind} "
                    f"{getattr(model, kind)(number).name!r}, which the task draws itself for each "
                    "episode; leave the effect out of the report"
                )


def _changes(template: mujoco.MjModel, models: Sequence[mujoco.MjModel]) -> dict[str, Any]:
    """By field: where models differ from a template, and their values there [models, n]."""
    base, each = numbers(template), [numbers(model) for model in models]
    found = {}
    for name, values in base.items():
        theirs = [views.get(name) for views in each]
        if any(one is None or one.shape != values.shape for one in theirs):
            raise InputError(
                f"an effect of the diagnosis changes the size of {name!r}: it adds joints or "
                "bodies, and cannot be drawn for each episode; leave it out of the report"
            )
        stacked = np.stack([np.asarray(one) for one in theirs])
        where = (stacked != values).any(axis=0)
        if where.any():
            found[name] = (where, stacked[:, where])
    return found


def _of(seed: int, number: int) -> int:
    return int(stream(seed, 11 + number).integers(2**31))


def _number(seed: int, count: int) -> int:
    """Which scene an episode has: another stream of its seed than those of the task."""
    return int(stream(seed, 7).integers(count))
