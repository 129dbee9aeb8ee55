"""Cubes' poses read off images."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parent.parent.parent.parent / "tools"))

from cloning import eyes
from cloning.policy import save
from cloning.seen import OWN


def test_places_of_a_bright_spot_are_learnt() -> None:
    """Where something is in the image comes through the spatial softmax, whatever else changes."""
    torch.manual_seed(0)
    made = eyes.Eyes()
    size = 24  # of any size are images that a softmax over places is taken of
    place = torch.randint(2, size - 6, (12, 2))
    images = torch.zeros(12, 2, size, size, 3, dtype=torch.uint8)
    for image, (row, column) in zip(images, place.tolist(), strict=True):
        image[:, row : row + 4, column : column + 4] = 255
    wanted = (place.float() / size - 0.5)[:, None].repeat(1, 3, 1)
    optimizer = torch.optim.Adam(made.parameters(), lr=2e-3)
    losses = []
    for _ in range(25):
        pos, _ = made(images, torch.zeros(12, OWN))
        loss = (pos[..., :2] - wanted).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]


def test_eyes_are_kept_in_half_precision(tmp_path: Path) -> None:
    made = eyes.Eyes()
    images, own = torch.zeros(1, 2, 24, 24, 3, dtype=torch.uint8), torch.ones(1, OWN)
    before = made(images, own)
    save(made.half(), tmp_path, {})
    after = eyes.load_eyes(tmp_path)(images, own)
    np.testing.assert_allclose(before[0].detach(), after[0].detach(), atol=2e-3)
