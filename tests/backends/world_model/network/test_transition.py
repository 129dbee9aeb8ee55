"""Equation RSSM, the predicted latent."""

from __future__ import annotations

import torch
from orbisim_world_model.network.transition import Transition


def test_with_and_without_what_the_coupling_gave() -> None:
    h, e = torch.randn(2, 3, 4), torch.randn(2, 3, 4)
    plain, skipping = Transition(4, skip=False), Transition(4, skip=True)
    torch.testing.assert_close(plain(h, e), plain(h, 0 * e), atol=0, rtol=0)
    for parameter in skipping.parameters():
        torch.nn.init.zeros_(parameter)
    torch.testing.assert_close(skipping(h, e), e, atol=0, rtol=0)
