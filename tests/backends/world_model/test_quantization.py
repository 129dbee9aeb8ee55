"""Weights in few bits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from orbisim_world_model.quantization import BITS, GROUP, quantized, read_weights
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from orbisim.errors import InputError


def _matrix(rows: int = 7, columns: int = 70) -> Tensor:
    matrix = torch.randn(rows, columns, generator=torch.Generator().manual_seed(0))
    matrix[2] = 0.0
    matrix[:, 32:64] = 0.0
    return matrix


def _read(path: Path, tensors: dict[str, Tensor], shape: tuple[int, ...]) -> Any:
    save_file(tensors, str(path))
    with safe_open(str(path), framework="pt") as file:
        names = {name: name for name in file.keys()}  # noqa: SIM118
        return read_weights(file, names, {"a.weight": shape, "a.bias": (3,)})


@pytest.mark.parametrize("bits", [BITS[0], 7, 8, 12, BITS[-1]])
def test_a_file_gives_back_what_was_rounded(bits: int, tmp_path: Path) -> None:
    matrix = quantized(_matrix(), bits)
    tensors = matrix.tensors("a.weight") | {"a.bias": torch.ones(3)}
    found = _read(tmp_path / "a.safetensors", tensors, (7, 70))
    assert torch.equal(found["a.weight"], matrix.weights())
    groups = 6 * 2  # of zeros there are no integers
    assert tensors[f"a.weight.int{bits}"].numel() == groups * GROUP * bits // 8


@pytest.mark.parametrize("bits", [4, 8, 12])
def test_nearest_is_within_half_a_step(bits: int) -> None:
    exact = _matrix()
    near = quantized(exact, bits).weights()
    padded = torch.nn.functional.pad(exact, (0, 26)).unflatten(1, (-1, GROUP))
    step = padded.abs().amax(-1).repeat_interleave(GROUP, 1)[:, :70] / (2 ** (bits - 1) - 1)
    assert ((near - exact).abs() <= 0.502 * step + 1e-7).all()
    assert (near[2] == 0).all()


def test_feedback_brings_products_closer() -> None:
    generator = torch.Generator().manual_seed(1)
    given = torch.randn(500, 6, generator=generator) @ torch.randn(6, 64, generator=generator)
    given = given + 0.05 * torch.randn(500, 64, generator=generator)
    matrix = torch.randn(20, 64, generator=generator)
    moments = given.T @ given / 500
    plain, better = (quantized(matrix, 6, m).weights() for m in (None, moments))
    off = [((w - matrix) @ given.T).square().mean().sqrt() for w in (plain, better)]
    assert off[1] < 0.5 * off[0]


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="4 to 16 bits; got 3"):
        quantized(_matrix(), 3)
    good = quantized(_matrix(), 8).tensors("a.weight") | {"a.bias": torch.ones(3)}
    path = tmp_path / "a.safetensors"
    cut = {**good, "a.weight.peaks": good["a.weight.peaks"][:1]}
    with pytest.raises(InputError, match="one float16 or float32 for each 32 weights"):
        _read(path, cut, (7, 70))
    with pytest.raises(InputError, match="integers of 8 bits are"):
        _read(path, {**good, "a.weight.int8": good["a.weight.int8"][:-1]}, (7, 70))
    with pytest.raises(InputError, match=r"a\.weight.* is not in the"):
        _read(path, {n: t for n, t in good.items() if n != "a.weight.peaks"}, (7, 70))
    with pytest.raises(InputError, match=r"a\.weight\.peaks is torch\.float16 of shape"):
        _read(path, good, (9, 70))
    endless = {**good, "a.weight.peaks": good["a.weight.peaks"] * torch.inf}
    with pytest.raises(InputError, match=r"is not finite|integers of 8 bits"):
        _read(path, endless, (7, 70))
