"""Worlds that diverge, and states that were never seen."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.guard import Guard, blanked
from orbisim_world_model.reading import read_layout

from tests.backends.world_model.synthetic import TABLE, simulate

RANGES = {
    "joint_speed": 2.0,
    "object_speed": 3.0,
    "object_turning": 4.0,
    "joints": {"x": [-0.4, 0.4], "y": [-0.4, 0.4]},
    "object_position": {"x": [-0.5, 0.5], "y": [-0.5, 0.5], "z": [0.03, 0.05]},
}


@pytest.fixture(scope="module")
def guard() -> Guard:
    layout = read_layout(mujoco.MjModel.from_xml_string(TABLE), 0.02)
    return Guard({"ranges": RANGES}, layout)


@pytest.fixture(scope="module")
def states():  # type: ignore[no-untyped-def]
    pack = simulate(TABLE, 1, 11, 4)
    x = pack.states(torch.arange(12))
    return type(x)(*(field.reshape(4, 3, *field.shape[1:]) for field in x))


def test_the_first_state_that_is_lost(guard: Guard, states) -> None:  # type: ignore[no-untyped-def]
    assert guard.diverged_at(states).tolist() == [-1, -1, -1]
    pos, v = states.pos.clone(), states.v.clone()
    pos[2:, 1] = torch.nan
    v[1, 2] = 100 * 2.0 + 1
    found = guard.diverged_at(states._replace(pos=pos, v=v))
    assert found.tolist() == [-1, 2, 1]
    gone = blanked(states, found)
    assert torch.isnan(gone.q[2:, 1]).all()
    assert torch.isnan(gone.pos[1:, 2]).all()
    assert torch.equal(gone.q[:, 0], states.q[:, 0])
    assert torch.equal(gone.q[:2, 1], states.q[:2, 1])


def test_one_worlds_coordinates(guard: Guard) -> None:
    fine = np.zeros((1, 3))
    assert not guard.lost(fine, fine)
    for bad in (np.nan, 1e4):
        assert guard.lost(np.array([[bad]]), fine)
    assert guard.lost(fine, np.array([[401.0]]))


def test_what_lies_outside_is_named(guard: Guard, states) -> None:  # type: ignore[no-untyped-def]
    x = states.at(0)
    calm = x._replace(
        q=0 * x.q, v=0 * x.v, vel=0 * x.vel, ang=0 * x.ang,
        pos=torch.tensor([0.0, 0.0, 0.04]).expand_as(x.pos),
    )  # fmt: skip
    assert guard.concerns(calm) == []
    (joint,) = guard.concerns(calm._replace(q=calm.q + torch.tensor([0.5, 0.0])))
    assert joint == "joint 'x' is at 0.5 (trained on -0.4 to 0.4)"
    (high,) = guard.concerns(calm._replace(pos=calm.pos + torch.tensor([0.0, 0.0, 0.1])))
    assert high == "an object's z is at 0.14 (trained on 0.03 to 0.05)"
    (fast,) = guard.concerns(calm._replace(vel=calm.vel + 7.0))
    assert fast == "object speed is 7 (trained up to 3)"
