"""The model: symmetry, masking, rotations, kinematics, gradients."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.rotation import exponential, multiply
from orbisim_world_model.trainer import new_model

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import BOX, PENDULUM, TABLE, simulate


def _batch(pack, rows=slice(0, 8)):  # type: ignore[no-untyped-def]
    index = torch.arange(len(pack.qpos))[rows]
    context = pack.context(torch.zeros(len(index), dtype=torch.long))
    return pack.states(index), pack.ctrl[index], context


@pytest.fixture(scope="module")
def table():  # type: ignore[no-untyped-def]
    pack = simulate(TABLE, 3, 20, 4)
    model = new_model(pack, toy(), 0)
    with torch.no_grad():  # decoders start near zero, which would hide differences
        for parameter in model.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return pack, model.eval()


@pytest.mark.parametrize("name", ["default", "recurrent", "paper", "no_relative"])
def test_permuting_objects_permutes_predictions(name: str) -> None:
    pack = simulate(TABLE, 3, 20, 4)
    model = new_model(pack, toy(name), 0).eval()
    x, control, context = _batch(pack)
    x = x._replace(vel=torch.randn_like(x.vel))
    swapped = x._replace(**{n: getattr(x, n).flip(1) for n in ("pos", "quat", "vel", "ang")})
    other = Context(context.attributes.flip(1), context.world, context.mask)
    h = model.initial_memory(8)
    a = model(x, h, control, context).state
    b = model(swapped, h, control, other).state
    for field in ("pos", "quat", "vel", "ang"):
        torch.testing.assert_close(getattr(b, field).flip(1), getattr(a, field), atol=2e-5, rtol=0)
    torch.testing.assert_close(b.q, a.q, atol=2e-5, rtol=0)


def test_padding_changes_nothing(table) -> None:  # type: ignore[no-untyped-def]
    pack, model = table
    x, control, context = _batch(pack)
    alone = Context(context.attributes, context.world, torch.tensor([[1.0, 0.0]]).expand(8, 2))
    h = model.initial_memory(8)
    before = model(x, h, control, alone).state
    junk = x.pos.clone()
    junk[:, 1] = 7.0
    noisy = context.attributes.clone()
    noisy[:, 1] = 3.0
    after = model(x._replace(pos=junk), h, control, alone._replace(attributes=noisy)).state
    torch.testing.assert_close(after.pos[:, 0], before.pos[:, 0], atol=1e-6, rtol=0)
    torch.testing.assert_close(after.q, before.q, atol=1e-6, rtol=0)
    seen = model(x._replace(pos=junk), h, control, context).state
    assert (seen.pos[:, 0] - before.pos[:, 0]).abs().max() > 1e-6  # unmasked it does matter


def test_one_object_fewer_is_a_masked_object(table) -> None:  # type: ignore[no-untyped-def]
    pack, model = table
    fewer = dataclasses.replace(pack.layout, objects=("one",), object_q=(2,), object_v=(2,))
    small = type(model)(fewer, model.config).build(model.controls)
    small.load_state_dict(model.state_dict())
    x, control, context = _batch(pack)
    masked = context._replace(mask=torch.tensor([[1.0, 0.0]]).expand(8, 2))
    a = model(x, model.initial_memory(8), control, masked).state
    part = Entities(x.q, x.v, x.act, x.hand, *(getattr(x, n)[:, :1] for n in x._fields[4:]))
    given = Context(context.attributes[:, :1], context.world, None)
    b = small.eval()(part, small.initial_memory(8), control, given).state
    torch.testing.assert_close(b.pos[:, 0], a.pos[:, 0], atol=1e-6, rtol=0)


def test_predicted_orientations_stay_on_the_manifold(table) -> None:  # type: ignore[no-untyped-def]
    pack, model = table
    x, control, context = _batch(pack)
    h = model.initial_memory(8)
    with torch.no_grad():
        for _ in range(30):
            step = model(x, h, control, context)
            x, h = step.state, step.memory
    torch.testing.assert_close(x.quat.norm(dim=-1), torch.ones(8, 2), atol=1e-5, rtol=0)


def test_turning_the_box_on_level_ground_turns_the_prediction() -> None:
    pack = simulate(BOX, 3, 20, 4)
    model = new_model(pack, toy(), 0).eval()
    x, control, context = _batch(pack)
    turn = exponential(torch.tensor([0.0, 0.0, 1.1]))
    matrix = torch.tensor(
        [[np.cos(1.1), -np.sin(1.1), 0.0], [np.sin(1.1), np.cos(1.1), 0.0], [0.0, 0.0, 1.0]],
        dtype=torch.float32,
    )
    other = x._replace(
        pos=x.pos @ matrix.T + torch.tensor([3.0, -1.0, 0.0]),
        quat=multiply(turn.expand_as(x.quat), x.quat),
        vel=x.vel @ matrix.T,
        ang=x.ang @ matrix.T,
    )
    h = model.initial_memory(8)
    a, b = (model(s, h, control, context).state for s in (x, other))
    torch.testing.assert_close(b.vel, a.vel @ matrix.T, atol=1e-5, rtol=0)
    moved = a.pos @ matrix.T + torch.tensor([3.0, -1.0, 0.0])
    torch.testing.assert_close(b.pos, moved, atol=1e-5, rtol=0)


@pytest.mark.parametrize("xml", [PENDULUM, TABLE, BOX])
def test_gradients_agree_with_finite_differences(xml: str) -> None:
    pack = simulate(xml, 3, 20, 2)
    model = new_model(pack, toy(), 0).eval().double()
    x, control, context = _batch(pack, slice(3, 4))
    x, control = x.to(torch.float64), control.double()
    context = Context(*(part.double() for part in context[:3]))
    h = model.initial_memory(1)
    weight = torch.randn(64, dtype=torch.float64)

    def value(v: torch.Tensor, vel: torch.Tensor, u: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        state = model.completed(x._replace(v=v, vel=vel))
        after = model(state, h, u, context._replace(attributes=a)).state
        flat = torch.cat([part.flatten() for part in (after.q, after.v, after.pos, after.vel)])
        return (flat * weight[: len(flat)]).sum()

    given = (x.v, x.vel, control, context.attributes)
    inputs = tuple(g.clone().requires_grad_(bool(g.numel())) for g in given)
    assert torch.autograd.gradcheck(value, inputs, eps=1e-6, atol=1e-5)
