"""What limbs touch: closest points of segments."""

from __future__ import annotations

import torch
from orbisim_world_model.touch import along, closest


def test_segments_that_are_points_or_parallel() -> None:
    a = torch.tensor([[[[0.0, 0, 0], [0, 0, 0]], [[0.0, 0, 0], [1, 0, 0]]]])
    b = torch.tensor([[[[1.0, 1, 0], [1, -1, 0]], [[0.5, 1, 0], [1.5, 1, 0]]]])
    shares = closest(a, b)
    apart = (along(b, shares[1]) - along(a, shares[0])).norm(dim=-1)
    torch.testing.assert_close(apart, torch.ones(1, 2))


def test_closest_points_are_those_that_a_search_finds() -> None:
    torch.manual_seed(0)
    a, b = torch.randn(2, 40, 1, 2, 3, dtype=torch.float64)
    s, t = closest(a, b)
    found = (along(b, t) - along(a, s)).norm(dim=-1)
    shares = torch.linspace(0, 1, 101, dtype=torch.float64)
    grid_a = a[..., None, 0, :] + shares[:, None] * (a[..., None, 1, :] - a[..., None, 0, :])
    grid_b = b[..., None, 0, :] + shares[:, None] * (b[..., None, 1, :] - b[..., None, 0, :])
    searched = torch.cdist(grid_a, grid_b).flatten(-2).amin(-1)
    assert (found <= searched + 1e-9).all()
    torch.testing.assert_close(found, searched, atol=0.03, rtol=0)


def test_values_between_two_ends() -> None:
    ends = torch.tensor([[[[0.0, 0, 0], [2.0, 4, 6]]]])
    share = torch.tensor([[[0.25]]])
    assert along(ends, share).tolist() == [[[0.5, 1.0, 1.5]]]
