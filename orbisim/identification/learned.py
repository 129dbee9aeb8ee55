"""Identification by gradients through a frozen learned model."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim.identification.estimate import Estimate, estimate
from orbisim.identification.parameters import Parameter
from orbisim.identification.residual import counted, errors
from orbisim.identification.windows import Grid
from orbisim.state import State

_OBJECT = {"friction": "friction_slide", "density": "density", "mass": "mass"}


class Conditioned(Protocol):
    """A backend whose worlds have properties of their own, with gradients."""

    name: str
    model: Any
    entity_names: tuple[str, ...]
    surface: str

    def with_properties(self, state: State, objects: Any = None, world: Any = None) -> State:
        """See `orbisim_world_model.backend`."""

    def rollout(self, state: State, controls: Any, **options: Any) -> Any:
        """See `Backend.rollout`."""


def simulation(
    backend: Conditioned, parameters: Sequence[Parameter], grid: Grid, device: str = "cpu"
) -> Callable[[Tensor], Tensor]:
    """From values [K W, P] to errors [K W, R] of the backend's rollouts (see `estimate`).

    Raises:
      InputError: a parameter is none that the model is conditioned on.
    """
    _check(backend, parameters)
    joints, bodies = counted(backend.model, parameters)
    qpos, qvel, act, ctrl, target = (
        torch.as_tensor(array, device=device)
        for array in (grid.qpos, grid.qvel, grid.act, grid.ctrl, grid.target)
    )
    time = torch.zeros(len(qpos), dtype=qpos.dtype, device=device)

    def run(values: Tensor) -> Tensor:
        objects: dict[str, dict[str, Tensor]] = {}
        world: dict[str, Tensor] = {}
        for number, parameter in enumerate(parameters):
            value = values[:, number]
            if parameter.target == backend.surface:
                world["friction_slide"] = value
            else:
                objects.setdefault(parameter.target, {})[_OBJECT[parameter.name]] = value
        first, *others, wanted = (
            torch.cat([given] * (len(values) // len(qpos)))
            for given in (time, qpos, qvel, act, ctrl, target)
        )
        state, controls = State(first, *others[:3]), others[3]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of values far from the data, on the way
            state = backend.with_properties(state, objects, world)
            path = backend.rollout(state, controls)
        return errors(path.qpos.to(target.dtype), wanted, joints, bodies)

    return run


def identify_learned(
    backend: Conditioned, parameters: Sequence[Parameter], grid: Grid, steps: int, device: str
) -> Estimate:
    """One problem with all windows."""
    run = simulation(backend, parameters, grid, device)
    start = torch.tensor([[p.declared for p in parameters]], dtype=torch.float64, device=device)
    low, high = (
        torch.tensor([getattr(p, end) for p in parameters], dtype=torch.float64, device=device)
        for end in ("low", "high")
    )
    group = torch.zeros(len(grid.qpos), dtype=torch.long, device=device)
    return estimate(run, start, (low, high), group, steps, grid.ctrl.shape[1])


def _check(backend: Conditioned, parameters: Sequence[Parameter]) -> None:
    objects = [name for name in backend.entity_names if name != "robot"]
    for parameter in parameters:
        of_object = parameter.target in objects and parameter.name in _OBJECT
        of_surface = parameter.target == backend.surface and parameter.name == "friction"
        if not (of_object or of_surface):
            surface = f" and friction of {backend.surface!r}" if backend.surface else ""
            raise InputError(
                f"{parameter.label}: the learned model knows friction, density and mass of "
                f"{', '.join(objects)}{surface}; use --backend mujoco for others"
            )
