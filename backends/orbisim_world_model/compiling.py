"""The losses of a training step compiled by torch, with the network and the physics around it."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.unroll import Moment, MomentLoss, Objective, moment_loss

_FIELDS = len(Entities._fields)


class CompiledMoment:
    """`unroll.moment_loss` compiled, once for each model and batch size.

    Models that correct MuJoCo's step are not compiled.
    """

    def __init__(self) -> None:
        self._fast: dict[int, Any] = {}

    def __call__(self, objective: Objective, moment: Moment, context: Context) -> MomentLoss:
        """See `moment_loss`."""
        if moment.base is not None:
            return moment_loss(objective, moment, context)
        key = id(objective.model)
        if key not in self._fast:
            self._fast[key] = torch.compile(_flat(objective), dynamic=False, fullgraph=True)
        found = self._fast[key](*_tensors(moment, context))
        state, rest = Entities(*found[:_FIELDS]), found[_FIELDS:]
        memory = rest[2] if len(rest) > 2 else moment.memory
        return MomentLoss(state, memory, rest[0], rest[1])


def _flat(objective: Objective) -> Any:
    """`moment_loss` from tensors to tensors (see `stepper.compiled_step`)."""
    remembers = objective.model.config.memory != "none"

    def function(*given: Tensor) -> tuple[Tensor, ...]:
        truth, target, predicted = (
            Entities(*given[i * _FIELDS : (i + 1) * _FIELDS]) for i in range(3)
        )
        memory, control, noise, chance, ratio, *static = given[3 * _FIELDS :]
        moment = Moment(truth, target, predicted, memory, control, None, noise, chance, ratio)
        found = moment_loss(objective, moment, Context(*static))
        kept = (found.memory,) if remembers else ()
        return (*found.state, found.loss, found.reconstruction, *kept)

    return function


def _tensors(moment: Moment, context: Context) -> list[Tensor]:
    """Everything in the same form at every step, so that torch compiles it once."""
    predicted, ratio = moment.predicted, moment.ratio
    if predicted is None:  # a share of 0 of it is taken
        predicted, ratio = moment.truth, torch.zeros_like(ratio)
    predicted = Entities(*map(_with_gradient, predicted))
    assert context.mask is not None
    return [
        *(field.contiguous() for field in (*moment.truth, *moment.target, *predicted)),
        moment.memory.contiguous(),
        moment.control,
        moment.noise,
        moment.chance,
        ratio,
        context.attributes,
        context.world,
        context.mask,
        *(part for part in (context.parts, context.part_mask) if part is not None),
    ]


def _with_gradient(field: Tensor) -> Tensor:
    return field if field.requires_grad else field.clone().requires_grad_()
