"""The search of motions by the cross-entropy method."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

from paying import search as searching
from paying.hop import Hop
from paying.search import KNOTS, Motion, load, save, search
from paying.training import tried


def test_a_motion_goes_through_its_knots_and_grows_with_what_is_asked_for() -> None:
    rng = np.random.default_rng(0)
    weights = torch.as_tensor(0.3 * rng.normal(size=(2, KNOTS))).float()
    motion = Motion(weights, asked=0, time=1)
    for knot in range(KNOTS):
        seen = torch.tensor([[0.0, knot / (KNOTS - 1)], [0.5, knot / (KNOTS - 1)]])
        expected = [weights[0, knot], weights[0, knot] + 0.5 * weights[1, knot]]
        np.testing.assert_allclose(motion(seen)[:, 0], expected, atol=1e-3)
    between = motion(torch.tensor([[0.0, 0.5 / (KNOTS - 1)]]))
    assert float(between) == pytest.approx(float(weights[0, :2].mean()), abs=1e-5)
    assert float(Motion(weights + 9, 0, 1)(torch.zeros(1, 2))) == 1.0


def test_worlds_have_motions_of_their_own() -> None:
    weights = torch.zeros(2, 2, KNOTS)
    weights[1, 0] = 0.7
    assert Motion(weights, 0, 1)(torch.zeros(2, 2)).tolist() == [[0.0], [pytest.approx(0.7)]]


def test_a_search_finds_better_motions_and_they_come_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(searching, "POPULATION", 16)
    monkeypatch.setattr(searching, "STARTS", 2)
    duty = Hop()
    still = Motion(torch.zeros(2, KNOTS), *duty.columns)
    found = search(duty, duty.columns, steps=6 * 16 * 2 * duty.steps, seed=0)
    save(found, tmp_path / "motion.safetensors")
    again = load(tmp_path / "motion.safetensors", duty.columns)
    worth = [tried(duty, motion, 8, 0)["reward"]["mean"] for motion in (still, found, again)]
    assert worth[1] > worth[0] + 0.05 and worth[1] == worth[2]
