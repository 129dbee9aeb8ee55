"""Checkpoints of vision in few bits: smaller, close, and refused where they are damaged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from orbisim_diffusion.checkpoint import MANIFEST, digest, load_checkpoint
from orbisim_diffusion.shrinking import shrink
from safetensors.torch import load_file, save_file

from orbisim.errors import InputError
from tests.backends.diffusion.tiny import arm, save_tiny


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_tiny(tmp_path_factory.mktemp("tiny"), arm())


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.glob("*.safetensors"))


def test_weights_are_rounded_in_groups_of_a_row(folder: Path, tmp_path: Path) -> None:
    shrink(folder, tmp_path, 8)
    assert _size(tmp_path) < 0.75 * _size(folder)  # names and vectors are much of a tiny network
    before, after = load_checkpoint(folder), load_checkpoint(tmp_path)
    assert after.one_step is None
    assert after.manifest["parameters"] == before.manifest["parameters"]
    for part in ("autoencoder", "denoiser"):
        ours, theirs = (getattr(point, part).state_dict() for point in (after, before))
        for name, weight in theirs.items():
            off = (ours[name] - weight).abs()
            if weight.dim() < 2:
                assert not off.any()
                continue
            rows = torch.nn.functional.pad(weight.flatten(1), (0, -weight[0].numel() % 32))
            step = rows.unflatten(1, (-1, 32)).abs().amax(-1) / 127
            room = step.repeat_interleave(32, 1)[:, : weight[0].numel()].reshape(weight.shape)
            assert (off <= 0.51 * room + 1e-7).all(), name
            assert off.any() or not weight.any()


def test_a_folder_may_be_shrunk_in_place(folder: Path, tmp_path: Path) -> None:
    shrink(folder, tmp_path, 10)
    shrink(tmp_path, tmp_path, 8)
    assert _size(tmp_path) < 0.75 * _size(folder)
    load_checkpoint(tmp_path)


def test_other_bits_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="4 to 16 bits"):
        shrink(folder, tmp_path, 3)


def test_damaged_integers_are_refused(folder: Path, tmp_path: Path) -> None:
    shrink(folder, tmp_path, 8)
    path, manifest = tmp_path / "denoiser.safetensors", tmp_path / MANIFEST
    tensors, notes = load_file(path), json.loads(manifest.read_text())
    name = next(name for name in tensors if name.endswith(".int8"))
    peaks = f"{name.removesuffix('.int8')}.peaks"
    for changed in (
        {**tensors, name: tensors[name][:-1]},
        {n: t for n, t in tensors.items() if n != peaks},
        {**tensors, peaks: tensors[peaks] * torch.inf},
    ):
        save_file(changed, path)
        notes["files"]["denoiser"]["sha256"] = digest(path)
        manifest.write_text(json.dumps(notes))
        with pytest.raises(InputError, match="damaged"):
            load_checkpoint(tmp_path)
