"""A step's gradients from what is computed again are those of the step itself, both ways."""

from __future__ import annotations

import pytest
import torch
from orbisim_world_model.differentiable import DifferentiableStep
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.stepper import plain_step
from orbisim_world_model.trainer import new_model
from torch import Tensor
from torch.autograd import forward_ad

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate

STEPS = 3
Inputs = tuple[Entities, Tensor, Tensor, Context]


@pytest.fixture(scope="module", params=["default", "recurrent"])
def given(request: pytest.FixtureRequest) -> tuple[Dynamics, Inputs]:
    """A model that moves things, and states, memory, controls [T, B, U] and descriptors."""
    pack = simulate(TABLE, 2, 20, 4)
    config = toy(request.param, "1x1x8")
    model = new_model(pack, config, 0).eval().requires_grad_(False)
    torch.manual_seed(0)
    for parameter in model.network.parameters():
        parameter.add_(0.05 * torch.randn_like(parameter))
    row, episode = torch.arange(4), torch.zeros(4, dtype=torch.long)
    controls = pack.controls(config.model)[row].expand(STEPS, -1, -1) + torch.randn(STEPS, 1, 1)
    x, memory = model.completed(pack.states(row)), model.initial_memory(4).detach().clone()
    return model, (x, memory, controls, pack.context(episode))


def _rolled(step: object, given: Inputs) -> Tensor:
    x, memory, controls, context = given
    total = torch.zeros(len(x.pos), dtype=x.pos.dtype)
    for control in controls:
        x, memory = step(x, memory, control, context)  # type: ignore[operator]
        total = total + sum(field.square().flatten(1).sum(1) for field in x)
    return total


def _both(model: Dynamics) -> tuple[object, object]:
    return plain_step(model), DifferentiableStep(model, torch.device("cpu"))


def test_values_and_gradients_are_the_steps_own(given: tuple[Dynamics, Inputs]) -> None:
    model, (x, memory, controls, context) = given
    leaves = [t.clone().requires_grad_() for t in (x.pos, x.vel, controls, context.attributes)]
    pos, vel, ctrl, attributes = leaves
    inputs = (x._replace(pos=pos, vel=vel), memory, ctrl, context._replace(attributes=attributes))
    wanted, found = (_rolled(step, inputs) for step in _both(model))
    torch.testing.assert_close(found, wanted)
    for one, other in zip(
        *(torch.autograd.grad(total.sum(), leaves) for total in (found, wanted)), strict=True
    ):
        assert float(other.abs().max()) > 0
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


def test_derivatives_along_a_direction_are_the_steps_own(given: tuple[Dynamics, Inputs]) -> None:
    model, (x, memory, controls, context) = given
    torch.manual_seed(1)
    along = torch.randn_like(context.attributes)
    slopes = []
    for step in _both(model):
        with forward_ad.dual_level():
            dual = forward_ad.make_dual(context.attributes.clone().requires_grad_(), along)
            total = _rolled(step, (x, memory, controls, context._replace(attributes=dual)))
            slopes.append(forward_ad.unpack_dual(total).tangent)
    assert float(slopes[0].detach().abs().max()) > 0
    torch.testing.assert_close(slopes[1], slopes[0], rtol=1e-4, atol=1e-6)


def test_second_derivatives_are_refused(given: tuple[Dynamics, Inputs]) -> None:
    model, (x, memory, controls, context) = given
    ctrl = controls.clone().requires_grad_()
    total = _rolled(_both(model)[1], (x, memory, ctrl, context)).sum()
    (slope,) = torch.autograd.grad(total, ctrl, create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice"):
        slope.square().sum().backward()


def test_shapes_that_come_back_keep_what_was_made_for_them(
    given: tuple[Dynamics, Inputs],
) -> None:
    model, (x, memory, controls, context) = given
    step = DifferentiableStep(model, torch.device("cpu"))
    few = (x.at(slice(2)), memory[:2], context._replace(
        attributes=context.attributes[:2], world=context.world[:2],
        mask=None if context.mask is None else context.mask[:2],
    ))  # fmt: skip
    for _ in range(2):
        step(x, memory, controls[0], context)
        step(few[0], few[1], controls[0][:2], few[2])
    assert len(step._slots) == 2 and not step.recorded  # a CPU has no graphs
