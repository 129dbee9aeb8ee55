"""From the decoder's numbers to the next state, and back."""

from __future__ import annotations

import pytest
import torch
from orbisim_world_model.integrate import advance, required, robot_outputs

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate


@pytest.mark.parametrize("name", ["default", "no_relative", "no_manifold", "no_residual"])
def test_advance_and_required_are_inverse(name: str) -> None:
    pack = simulate(TABLE, 3, 20, 4)
    config, dt = toy(name).model, pack.layout.timestep
    x, after = pack.states(torch.arange(0, 10)), pack.states(torch.arange(1, 11))
    found = advance(x, required(x, after, dt, config), dt, config)
    for field in ("q", "v", "pos", "vel", "ang"):
        torch.testing.assert_close(
            getattr(found, field), getattr(after, field), atol=2e-5, rtol=1e-5
        )
    same = (found.quat * after.quat).sum(-1).abs()
    torch.testing.assert_close(same, torch.ones_like(same), atol=1e-5, rtol=0)


def test_no_change_of_velocity_is_a_straight_line() -> None:
    pack = simulate(TABLE, 1, 5, 4)
    config, dt = toy().model, 0.05
    x = pack.states(torch.arange(3))
    x = x._replace(vel=torch.randn_like(x.vel), ang=torch.randn_like(x.ang))
    nothing = required(x, x, 0.0, config)._replace()
    assert all(part.abs().max() < 1e-6 for part in nothing)
    after = advance(x, nothing, dt, config)
    torch.testing.assert_close(after.pos, x.pos + dt * x.vel)
    torch.testing.assert_close(after.q, x.q + dt * x.v)
    turned = 2 * torch.acos((after.quat * x.quat).sum(-1).abs().clamp(max=1.0))
    torch.testing.assert_close(turned, dt * x.ang.norm(dim=-1), atol=2e-3, rtol=0)


def test_numbers_of_the_robot() -> None:
    layout = simulate(TABLE, 1, 5, 4).layout
    assert robot_outputs(layout, toy().model) == 2 * 2
    assert robot_outputs(layout, toy("paper").model) == 15
