"""Equation AdaLN."""

from __future__ import annotations

import torch
from orbisim_world_model.network.adaln import AdaptiveLayerNorm


def test_at_first_it_is_a_layer_norm() -> None:
    norm, u = AdaptiveLayerNorm(6, 3), torch.randn(4, 5, 6)
    expected = torch.nn.functional.layer_norm(u, (6,))
    torch.testing.assert_close(norm(u, torch.randn(4, 5, 3)), expected)


def test_the_equation() -> None:
    norm, u, c = AdaptiveLayerNorm(6, 3), torch.randn(5, 6), torch.randn(5, 3)
    torch.nn.init.normal_(norm.modulation.weight)
    linear = c @ norm.modulation.weight.T + norm.modulation.bias
    gamma, beta = linear[:, :6], linear[:, 6:]
    plain = (u - u.mean(1, True)) / (u.var(1, keepdim=True, correction=0) + 1e-5).sqrt()
    torch.testing.assert_close(norm(u, c), gamma * plain + beta)
