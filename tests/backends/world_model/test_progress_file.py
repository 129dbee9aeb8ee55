"""The state of an unfinished training."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from orbisim_world_model.progress_file import NAME, load_progress, save_progress
from safetensors.torch import save_file

from orbisim.errors import InputError

NOTES = {"seed": 1, "step": 7, "seconds": 2.5, "config": {"name": "default"}}


def test_there_and_back(tmp_path: Path) -> None:
    assert load_progress(tmp_path) is None
    tensors = {"values": torch.randn(5), "first": torch.zeros(2, 2)}
    save_progress(tmp_path / "new", tensors, NOTES)
    found = load_progress(tmp_path / "new")
    assert found is not None
    assert found[1] == NOTES
    assert all(torch.equal(found[0][name], tensor) for name, tensor in tensors.items())


@pytest.mark.parametrize(
    ("tensors", "notes", "message"),
    [
        ({"a": torch.tensor([float("nan")])}, NOTES, "a is not finite numbers"),
        ({"a": torch.zeros(1, dtype=torch.float64)}, NOTES, "in float32"),
        ({"a": torch.zeros(1)}, {**NOTES, "step": "7"}, "its notes have no step"),
        ({"a": torch.zeros(1)}, {}, "its notes have no seed"),
        ({"a": torch.zeros(1)}, {**NOTES, "step": -1}, "its notes say step -1"),
        ({"a": torch.zeros(1)}, {**NOTES, "seconds": float("nan")}, "its notes say seconds nan"),
    ],
)
def test_what_is_damaged(tmp_path: Path, tensors: dict, notes: dict, message: str) -> None:
    save_progress(tmp_path, tensors, notes)
    with pytest.raises(InputError, match=f"damaged; delete it to start afresh.*{message}"):
        load_progress(tmp_path)


def test_what_is_no_progress(tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(b"text")
    with pytest.raises(InputError, match="damaged"):
        load_progress(tmp_path)
    save_file({"a": torch.zeros(1)}, str(tmp_path / NAME))
    with pytest.raises(InputError, match="notes"):
        load_progress(tmp_path)
