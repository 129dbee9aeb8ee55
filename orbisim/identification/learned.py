"""Identification by gradients through a frozen learned model."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import torch
from torch import Tensor

from orbisim.errors import DivergedError, InputError
from orbisim.identification.estimate import PRIOR, Estimate, estimate
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

    def trained(self, target: str, name: str) -> tuple[float, float] | None:
        """See `orbisim_world_model.backend`."""

    def rollout(self, state: State, controls: Any, **options: Any) -> Any:
        """See `Backend.rollout`."""


class Described:
    """A backend whose windows have attributes of their own: of other scenes, with other sizes.

    Args:
      backend: a learned one. attributes: [W, ...] of each window's scene, as the backend's
        `with_descriptors` takes them, on its device.
    """

    def __init__(self, backend: Any, attributes: Tensor) -> None:
        self._inner, self._attributes = backend, attributes
        self.name, self.model, self.surface = backend.name, backend.model, backend.surface
        self.entity_names = backend.entity_names

    def trained(self, target: str, name: str) -> tuple[float, float] | None:
        """The backend's."""
        found: tuple[float, float] | None = self._inner.trained(target, name)
        return found

    def with_properties(self, state: State, objects: Any = None, world: Any = None) -> State:
        """The backend's, with the attributes first; W windows in K copies."""
        copies = torch.cat([self._attributes] * (state.nworld // len(self._attributes)))
        state = self._inner.with_descriptors(state, attributes=copies)
        found: State = self._inner.with_properties(state, objects, world)
        return found

    def rollout(self, state: State, controls: Any, **options: Any) -> Any:
        """The backend's."""
        return self._inner.rollout(state, controls, **options)


class Simulation:
    """A backend's rollouts over windows, by values of parameters.

    Raises:
      InputError: a parameter is none that the model is conditioned on.
    """

    def __init__(
        self,
        backend: Conditioned,
        parameters: Sequence[Parameter],
        grid: Grid,
        device: str = "cpu",
    ) -> None:
        _check(backend, parameters)
        self._backend, self._parameters = backend, parameters
        self._counted = counted(backend.model, parameters)
        self._arrays = tuple(
            torch.as_tensor(array, device=device)
            for array in (grid.qpos, grid.qvel, grid.act, grid.ctrl, grid.target)
        )

    def __call__(self, values: Tensor) -> Tensor:
        """Errors [K W, R] by values [K W, P] (see `estimate`)."""
        path, wanted = self.run(values)
        joints, bodies = self._counted
        return errors(path.qpos.to(wanted.dtype), wanted, joints, bodies)

    def run(self, values: Tensor, **options: Any) -> tuple[Any, Tensor]:
        """What `rollout` gives for values [K W, P], and the positions that were recorded.

        Args:
          options: of `rollout`.
        """
        backend, count = self._backend, len(self._arrays[0])
        objects: dict[str, dict[str, Tensor]] = {}
        world: dict[str, Tensor] = {}
        for number, parameter in enumerate(self._parameters):
            value = values[:, number]
            if parameter.target == backend.surface:
                world["friction_slide"] = value
            else:
                objects.setdefault(parameter.target, {})[_OBJECT[parameter.name]] = value
        *start, controls, wanted = (
            torch.cat([given] * (len(values) // count)) for given in self._arrays
        )
        time = torch.zeros(len(values), dtype=start[0].dtype, device=start[0].device)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of values far from the data, on the way
            state = backend.with_properties(State(time, *start), objects, world)
            return backend.rollout(state, controls, **options), wanted


Guess = Mapping[str, tuple[float, float]]
"""By labels of parameters: a value, and the standard deviation of its logarithm."""


def identify_learned(
    backend: Conditioned,
    parameters: Sequence[Parameter],
    grid: Grid,
    steps: int,
    device: str,
    guess: Guess | None = None,
) -> Estimate:
    """One problem with all windows; with states read off frames PhyInf, one scene at a time.

    Args:
      guess: where the search begins, and its prior, of some of the parameters (others: declared).

    Raises:
      DivergedError: every window's rollout diverges, with what was found, too.
    """
    simulation = Simulation(backend, parameters, grid, device)
    ends = [bounds(backend, parameter) for parameter in parameters]
    low, high = torch.tensor(ends, dtype=torch.float64, device=device).T
    guess = guess or {}
    begun = [guess.get(p.label, (p.declared, math.log(PRIOR))) for p in parameters]
    start, spread = torch.tensor([begun], dtype=torch.float64, device=device).unbind(-1)
    group = torch.zeros(len(grid.qpos), dtype=torch.long, device=device)
    limits, count = (low, high), grid.ctrl.shape[1]
    found = estimate(simulation, start, limits, group, steps, count, spread=spread)
    _check_end(simulation, found.values[group])
    return found


def bounds(backend: Conditioned, parameter: Parameter) -> tuple[float, float]:
    """Of a parameter, within what the model has seen: beyond that its rollouts mean nothing."""
    known = backend.trained(parameter.target, _OBJECT[parameter.name])
    if known is None or not known[0] < known[1]:
        return parameter.low, parameter.high
    return max(parameter.low, known[0]), min(parameter.high, known[1])


def _check_end(simulation: Simulation, values: Tensor) -> None:
    """Says which windows diverge with what was found; they have counted as far off.

    Raises:
      DivergedError: all of them do, so that nothing was fitted.
    """
    with torch.no_grad():
        try:
            simulation.run(values, raise_on_divergence=True)
        except DivergedError as error:
            if len(error.worlds) == len(values):
                raise
            warnings.warn(f"identification, windows as worlds: {error}", stacklevel=3)


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
