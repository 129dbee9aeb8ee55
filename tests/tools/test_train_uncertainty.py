"""A finished checkpoint with an uncertainty, and the figures of it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_world_model import zoo
from orbisim_world_model.checkpoint import load_checkpoint
from safetensors.torch import load_file

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import train_uncertainty

SHIPPED = Path(zoo.__file__).parent / "zoo" / "push_contacts"


def test_what_else_a_checkpoint_has_stays_to_the_bit(tmp_path: Path) -> None:
    checkpoint = load_checkpoint(SHIPPED)
    model = checkpoint.model.with_spread(24)  # half as wide
    factor = {"robot": [1.0, 2.0], "objects": [3.0, 4.0]}
    known = {"width": 24, "level": 0.9, "floor": 0.05, "factor": factor}
    train_uncertainty._write(checkpoint, model, known, tmp_path)
    before, after = (load_file(str(at / "model.safetensors")) for at in (SHIPPED, tmp_path))
    assert before.keys() == after.keys()
    for name, tensor in after.items():
        if name.startswith("spread."):
            part = model.spread.get_parameter(name.removeprefix("spread."))  # type: ignore[union-attr]
            assert torch.equal(tensor, part)
        else:
            assert tensor.dtype == before[name].dtype and torch.equal(tensor, before[name])
    found = load_checkpoint(tmp_path)
    assert found.manifest["uncertainty"] == known
    assert found.manifest["parameters"] < checkpoint.manifest["parameters"]
    assert found.manifest["metrics"] == checkpoint.manifest["metrics"]
    assert (tmp_path / "card.md").read_bytes() == (SHIPPED / "card.md").read_bytes()
    assert json.loads((tmp_path / "manifest.json").read_text())["schema"] == "orbisim.dynamics/1"


def test_the_area_under_the_curve_counts_ties_half() -> None:
    score = np.array([1.0, 2.0, 2.0, 3.0])
    assert train_uncertainty.auroc(score, np.array([False, False, True, True])) == 0.875
    assert train_uncertainty.auroc(-score, np.array([False, False, True, True])) == 0.125
    assert train_uncertainty.auroc(score, np.zeros(4, bool)) is None


def test_figures_of_intervals_leave_out_cubes_that_are_not_there() -> None:
    errors, mask = torch.zeros(10, 4, 3, 2), torch.ones(4, 3)
    errors[9, 0, 1, 0] = 60.0  # mm: failed
    errors[9, 1, 1, 1] = 2.0
    errors[9, 2, 2] = 1e6
    mask[2, 2] = 0.0
    errors[9, :2, 0, 0] = 5.0  # the hand's
    found = train_uncertainty.measured(torch.ones(10, 4, 3, 2), errors, mask)["10"]
    assert found["failed"] == pytest.approx(1 / 7)
    assert found["coverage_position"] == found["coverage_rotation"] == pytest.approx(6 / 7)
    assert found["coverage_hand"] == 0.5
