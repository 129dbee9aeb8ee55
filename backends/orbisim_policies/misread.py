"""A problem whose policy sees states that are off as readings of films were off.

The paper's policies from pixels are trained from inferred beginnings, and on exact states from
there on; a policy that has known exact states alone does not stand what is read off frames. Here
the state that the policy sees is the model's (or MuJoCo's) own, moved as a film's reading was off
from its truth at the same step: errors of successive frames belong together, as do those of
positions and velocities.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from orbisim_world_model.rotation import conjugate, multiply, normalized
from torch import Tensor

from orbisim.scene import Scene
from orbisim_policies.films import Films
from orbisim_policies.problem import Floats, Moment, Problem, Starts

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class Misreading:
    """How far off readings of E films of T frames were.

    Args:
      model: whose coordinates they are. films: as read, and as they were.
    """

    def __init__(self, model: mujoco.MjModel, films: Films) -> None:
        def put(values: Floats) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32)

        read, true = put(films.qpos), put(films.true_qpos)
        self.speed = put(films.qvel - films.true_qvel)
        self.offset = read - true
        starts = model.jnt_qposadr[model.jnt_type == _FREE]
        self._quats = [slice(int(a) + 3, int(a) + 7) for a in starts]
        turns = []
        for columns in self._quats:
            self.offset[..., columns] = 0.0
            turns.append(multiply(conjugate(normalized(true[..., columns])), read[..., columns]))
        self.turns = torch.stack(turns, 2) if turns else torch.zeros((*read.shape[:2], 0, 4))

    def __len__(self) -> int:
        return len(self.offset)

    def to(self, device: torch.device) -> Misreading:
        """The same on a device."""
        moved = copy.copy(self)
        for name in ("offset", "speed", "turns"):
            setattr(moved, name, getattr(self, name).to(device))
        return moved

    def seen(self, qpos: Tensor, qvel: Tensor, film: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
        """What qpos [N, nq] and qvel [N, nv] would be read as, at a step [N] of films [N]."""
        row = film.long() * self.offset.shape[1] + step.long().clamp(0, self.offset.shape[1] - 1)
        moved = qpos + self.offset.flatten(0, 1)[row]
        turned = self.turns.flatten(0, 1)[row]
        parts, last = [], 0
        for number, columns in enumerate(self._quats):
            parts += [moved[:, last : columns.start]]
            parts += [multiply(normalized(qpos[:, columns]), turned[:, number])]
            last = columns.stop
        parts.append(moved[:, last:])
        return torch.cat(parts, 1), qvel + self.speed.flatten(0, 1)[row]


class MisreadProblem(Problem):
    """A problem, seen with the errors of films; what no frame shows of a scene is seen as nominal.

    Each episode has the errors of one film. Its number is the last one of the command; the score
    has that of the true states, that of the states seen, the film, and the step.

    Args:
      problem: to be seen so. films: whose errors they are.
    """

    def __init__(self, problem: Problem, films: Films) -> None:
        self._problem = problem
        self._misreading = Misreading(problem.scene.model, films)
        self.name, self.scene, self.timestep = problem.name, problem.scene, problem.timestep
        self.steps, self.actions = problem.steps, problem.actions
        self.observations, self.parts = problem.observations, problem.parts
        self.sparse = problem.sparse

    @property
    def template(self) -> Scene:
        """The problem's own."""
        return self._problem.template

    @property
    def backend(self) -> str:
        """The problem's own."""
        return self._problem.backend

    @property
    def conditions(self) -> Mapping[str, Any]:
        """The problem's own."""
        return self._problem.conditions

    @property
    def alterations(self) -> Mapping[str, tuple[mujoco.MjModel, mujoco.MjModel]]:
        """The problem's own."""
        return self._problem.alterations

    def to(self, device: torch.device) -> MisreadProblem:
        """See `Problem.to`."""
        moved = copy.copy(self)
        moved._problem = self._problem.to(device)
        moved._misreading = self._misreading.to(device)
        return moved

    def draw(self, seeds: Sequence[int]) -> Starts:
        """The problem's own; an episode's film is the rest of its seed by their number."""
        return self.numbered(self._problem.draw(seeds), [s % len(self._misreading) for s in seeds])

    def numbered(self, starts: Starts, films: Sequence[int]) -> Starts:
        """Starts of the problem, with these films' errors."""
        column = np.array(films, float)[:, None]
        return dataclasses.replace(starts, command=np.append(starts.command, column, axis=1))

    def trials(self, count: int, seed: int) -> tuple[Scene, Starts]:
        """See `Problem.trials`."""
        scene, starts = self._problem.trials(count, seed)
        films = [(seed + i) % len(self._misreading) for i in range(count)]
        return scene, self.numbered(starts, films)

    def write(self, model: mujoco.MjModel, params: Floats) -> None:
        """The problem's own."""
        self._problem.write(model, params)

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """See `Problem.begin`."""
        film, own = command[:, -1:], command[:, :-1]
        first = torch.zeros_like(film)
        read = self._misreading.seen(qpos, qvel, film[:, 0], first[:, 0])
        true, seen = (self._problem.begin(*x, own) for x in ((qpos, qvel), read))
        return torch.cat([true, seen, film, first], 1)

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """See `Problem.count`."""
        true, seen, film, step = self._parts(score)
        read = self._misreading.seen(qpos, qvel, film[:, 0], step[:, 0] + 1.0)
        true = self._problem.count(true, qpos, qvel, control)
        seen = self._problem.count(seen, *read, control)
        return torch.cat([true, seen, film, step + 1.0], 1)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """See `Problem.value`: of the true states."""
        return self._problem.value(self._parts(score)[0], qpos)

    def measure(self, score: Tensor, qpos: Tensor) -> Tensor:
        """See `Problem.measure`: of the true states."""
        return self._problem.measure(self._parts(score)[0], qpos)

    def observe(self, moment: Moment) -> Tensor:
        """See `Problem.observe`: of the states seen."""
        _, seen, film, step = self._parts(moment.score)
        qpos, qvel = self._misreading.seen(moment.qpos, moment.qvel, film[:, 0], step[:, 0])
        own = moment.command[:, :-1]
        params = self._problem.unseen(moment.params)
        return self._problem.observe(
            moment._replace(qpos=qpos, qvel=qvel, command=own, score=seen, params=params)
        )

    def unseen(self, params: Tensor) -> Tensor:
        """The problem's own."""
        return self._problem.unseen(params)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """See `Problem.control`."""
        control, after = self._problem.control(command[:, :-1], action)
        return control, torch.cat([after, command[:, -1:]], 1)

    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """The problem's own."""
        return self._problem.success(starts, qpos, value)

    @staticmethod
    def _parts(score: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        half = (score.shape[1] - 2) // 2
        return score[:, :half], score[:, half:-2], score[:, -2:-1], score[:, -1:]
