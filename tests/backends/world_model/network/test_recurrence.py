"""Equation RSSM, the memory."""

from __future__ import annotations

import torch
from orbisim_world_model.network.recurrence import Recurrence


def test_what_gates_do() -> None:
    cell, h, e = Recurrence(4), torch.randn(2, 3, 4), torch.randn(2, 3, 4)
    with torch.no_grad():
        for update, expected in ((-50.0, h), (50.0, None)):
            cell.norm.weight.zero_()
            cell.norm.bias.copy_(torch.tensor([50.0] * 4 + [0.3] * 4 + [update] * 4))
            after = cell(h, e)
            goal = torch.tanh(torch.full_like(h, 0.3)) if expected is None else expected
            torch.testing.assert_close(after, goal)


def test_it_remembers_at_first() -> None:
    torch.manual_seed(0)
    cell = Recurrence(32)
    h, e = torch.randn(2, 50, 3, 32)
    after = cell(h, e)
    kept = torch.nn.functional.cosine_similarity(after.flatten(), h.flatten(), dim=0)
    assert kept > 0.8
