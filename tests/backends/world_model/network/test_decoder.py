"""Equation RSSM, the predicted state."""

from __future__ import annotations

import pytest
import torch
from orbisim_world_model.network.decoder import Decoder


@pytest.mark.parametrize(("robot", "count"), [(4, 2), (0, 2), (4, 0)])
def test_numbers_for_each_entity_from_its_token_alone(robot: int, count: int) -> None:
    decoder = Decoder(8, robot, 13, count)
    z = torch.randn(3, int(robot > 0) + count, 8)
    r, o = decoder(z)
    assert (r.shape, o.shape) == ((3, robot), (3, count, 13))
    if robot:
        z[:, 0] += 1.0
        again = decoder(z)
        assert not torch.equal(again[0], r)
        torch.testing.assert_close(again[1], o, atol=0, rtol=0)


def test_at_first_hardly_anything_changes() -> None:
    r, o = Decoder(64, 4, 13, 2)(torch.randn(100, 3, 64))
    assert r.abs().max() < 0.3
    assert o.abs().max() < 0.3
