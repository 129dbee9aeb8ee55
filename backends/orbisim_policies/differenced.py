"""Worlds stepped by C MuJoCo whose derivatives are finite differences (`mjd_transitionFD`).

What analytic gradients cost without a learned step: each derivative takes two steps of the true
simulator for every coordinate of the state and every control.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from orbisim_world_model.entities import Context, Entities
from torch import Tensor

from orbisim.errors import DivergedError, InputError
from orbisim.gradients import step as differentiable_step
from orbisim.registry import make_backend
from orbisim.state import State
from orbisim_policies.learned import Pool
from orbisim_policies.problem import Problem, Starts


class DifferencedWorlds:
    """C MuJoCo's step of a problem's scene, with gradients by central differences.

    The states stand in `Entities` as generalized coordinates: `q` is qpos, `v` is qvel, and there
    are no objects. A world that diverges is not a number from there on, as in the learned step.

    Args:
      problem: on the CPU; all of its episodes are in one scene. nthread: of MuJoCo.

    Attributes:
      true_per_step: control steps of C MuJoCo that a differentiated one takes: itself, and two for
        each number of the state and of the control.

    Raises:
      InputError: the scene differs from episode to episode.
    """

    name = "mujoco"

    def __init__(self, problem: Problem, nthread: int = 0) -> None:
        if problem.draw([0]).params.shape[1]:
            raise InputError(
                f"{problem.name}: episodes have scenes of their own, which finite differences "
                "through mujoco do not; use --backend learned"
            )
        self.problem, self.device = problem, torch.device("cpu")
        self._model = problem.model
        self._make: Callable[[int], Any] = lambda n: make_backend(
            "mujoco", problem.scene, nworld=n, nthread=nthread
        )
        self._backends: dict[int, Any] = {}
        self._substeps = round(problem.timestep / self._model.opt.timestep)
        model = self._model
        self.true_per_step = 1 + 2 * (2 * model.nv + model.na + model.nu)

    def pool(self, starts: Starts) -> Pool:
        """Starts as tensors."""

        def put(values: Any) -> Tensor:
            return torch.as_tensor(np.asarray(values), dtype=torch.float32)

        act = np.zeros((len(starts), self._model.na))
        nothing = np.zeros((len(starts), 0))
        given = (starts.qpos, starts.qvel, act, starts.command, starts.params, nothing, nothing)
        return Pool(*map(put, given))

    def begin(self, starts: Pool) -> tuple[Entities, Context]:
        """The states, and nothing that they are conditioned on."""
        count = len(starts.qpos)
        none = [starts.qpos.new_zeros((count, *shape)) for shape in _NONE]
        x = Entities(starts.qpos, starts.qvel, starts.act, *none)
        return x, Context(starts.attributes, starts.settings, None)

    def step(self, x: Entities, control: Tensor, context: Context) -> Entities:
        """The states after a control step of the problem."""
        fine = x.q.isfinite().all(1) & x.v.isfinite().all(1) & control.isfinite().all(1)
        after, lost = self._stepped(x, control, fine)
        return x._replace(
            **{
                name: torch.where(lost[:, None], torch.nan, value.float())
                for name, value in zip(("q", "v", "act"), after, strict=True)
            }
        )

    def _stepped(
        self, x: Entities, control: Tensor, fine: Tensor
    ) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor]:
        """Coordinates after the step, and which worlds [N] have none."""
        rest = torch.as_tensor(self._model.qpos0, dtype=x.q.dtype)
        for _ in range(2):
            at = fine[:, None]
            state = State(
                np.zeros(len(x.q)),
                torch.where(at, x.q, rest).double(),
                torch.where(at, x.v, 0.0).double(),
                torch.where(at, x.act, 0.0).double(),
            )
            held = torch.where(at, control, 0.0).double()
            try:
                after = differentiable_step(self._backend(len(x.q)), state, held, self._substeps)
            except DivergedError as error:
                fine = fine.clone()
                fine[list(error.worlds)] = False
                continue
            return (after.qpos, after.qvel, after.act), ~fine
        raise DivergedError(f"{self.problem.name}: diverged at rest")

    def _backend(self, count: int) -> Any:
        """For so many worlds."""
        if count not in self._backends:
            self._backends[count] = self._make(count)
        return self._backends[count]

    def coordinates(self, x: Entities) -> tuple[Tensor, Tensor]:
        """qpos [N, nq] and qvel [N, nv]."""
        return x.q, x.v


_NONE = ((0,), (0, 3), (0, 4), (0, 3), (0, 3))
"""Shapes of a world's hand and objects: there are none."""
