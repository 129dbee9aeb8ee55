"""Equation RSSM, the latents of entities."""

from __future__ import annotations

import pytest
import torch
from orbisim_world_model.network.encoder import Encoder


@pytest.mark.parametrize(("robot", "objects"), [(5, 7), (0, 7), (5, 0)])
def test_each_token_depends_on_its_own_state_alone(robot: int, objects: int) -> None:
    encoder = Encoder(robot, objects, 8)
    first, many = int(robot > 0), 3 if objects else 0
    h, r, o = torch.randn(2, first + many, 8), torch.randn(2, robot), torch.randn(2, many, objects)
    z = encoder(h, r, o)
    assert z.shape == (2, first + many, 8)
    other = encoder(h, r + 1.0, o)
    changed = (other - z).abs().amax((0, 2)) > 1e-6
    assert changed.tolist() == [True] * first + [False] * many
    if objects:
        o[:, 1] += 1.0
        changed = (encoder(h, r, o) - z).abs().amax((0, 2)) > 1e-6
        assert changed.tolist() == [False] * first + [False, True, False]
