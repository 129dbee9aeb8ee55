"""Boxes at rest stay where they are; what moves, falls or tips is left to the network."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.rest import Rest
from orbisim_world_model.trainer import new_model

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate

LAYOUT = Layout(
    nq=7,
    nv=6,
    na=0,
    nu=0,
    timestep=0.05,
    objects=("box",),
    object_q=(0,),
    object_v=(0,),
    attributes=("half_x", "half_y", "half_z", "type_box"),
    settings=("gravity_x", "gravity_y", "gravity_z"),
)


def _state(vel: float = 0.0, tilt: float = 0.0, drop: float = 0.0) -> Entities:
    empty = torch.zeros(1, 0)
    quat = torch.tensor([[[1.0, tilt / 2, 0.0, 0.0]]])
    quat = quat / quat.norm()
    pos = torch.tensor([[[0.1, 0.2, 0.025 - drop]]])
    return Entities(
        *(empty, empty, empty, empty, pos, quat),
        torch.tensor([[[vel, 0.0, 0.0]]]),
        torch.zeros(1, 1, 3),
    )


def _context(gravity: float = -9.81, box: float = 1.0) -> Context:
    attributes = torch.tensor([[[0.025, 0.025, 0.025, box]]])
    return Context(attributes, torch.tensor([[0.0, 0.0, gravity]]), None)


@pytest.mark.parametrize(
    ("before", "after", "context", "held"),
    [
        (_state(), _state(vel=1e-3, drop=1e-5), _context(), True),  # creeps
        (_state(), _state(vel=0.1), _context(), False),  # is pushed
        (_state(), _state(drop=2e-3), _context(), False),  # was nudged within the step
        (_state(vel=0.1), _state(), _context(), False),  # stops within the step
        (_state(), _state(vel=0.49), _context(), False),  # falls
        (_state(tilt=0.1), _state(tilt=0.1), _context(), False),  # stands on an edge
        (_state(tilt=0.003), _state(tilt=0.003), _context(), True),
        (_state(vel=1e-3), _state(vel=1e-3), _context(gravity=0.0), False),  # floats
        (_state(), _state(vel=1e-3), _context(box=0.0), False),  # a ball rolls
        (_state(), _state(vel=float("nan")), _context(), False),  # is not hidden
    ],
)
def test_what_is_held(before: Entities, after: Entities, context: Context, held: bool) -> None:
    rest = Rest(LAYOUT)
    assert bool(rest.held(before, after, context)) is held
    found = rest(before, after, context)
    if held:
        assert torch.equal(found.pos, before.pos) and torch.equal(found.quat, before.quat)
        assert not found.vel.any() and not found.ang.any()
    else:
        assert torch.equal(found.vel.nan_to_num(7), after.vel.nan_to_num(7))


def test_a_model_holds_boxes_when_it_predicts_and_not_when_it_learns() -> None:
    pack = simulate(TABLE, 3, 20, 10)
    model = new_model(pack, toy(model__rest=True), 0)
    assert model.rest is not None
    last = pack.start + pack.length  # all has come to rest, the network knows nothing
    x, context = pack.states(last), pack.context(torch.arange(3))
    x = x._replace(vel=torch.zeros_like(x.vel), ang=torch.zeros_like(x.ang))
    with torch.no_grad():
        for parameter in model.network.f_dec.parameters():
            parameter.mul_(3e-3)
        control = pack.ctrl[last]
        learning = model.train()(x, model.initial_memory(3), control, context).state
        predicting = model.eval()(x, model.initial_memory(3), control, context).state
    flat = x.quat[..., 0].abs() > 0.9999
    assert flat.any()
    assert torch.equal(predicting.pos[flat], x.pos[flat])
    assert not torch.equal(learning.pos[flat], x.pos[flat])


def test_layouts_without_sizes_have_no_rest() -> None:
    assert not Rest.suits(dataclasses.replace(LAYOUT, attributes=("mass",)))
