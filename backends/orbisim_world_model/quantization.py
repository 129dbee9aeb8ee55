"""Weights in few bits: how they are rounded, and how they stand in a file.

Every 32 weights of a row of a matrix have a peak p, the largest that they may be, and are
p n / (2^(bits - 1) - 1) with integers n. In a safetensors file a matrix NAME is two tensors:
`NAME.intB` [bytes] with the integers of all groups whose peak is not 0, B bits each without gaps,
and `NAME.peaks` [rows, groups], float16 (or float32).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from orbisim.errors import InputError

GROUP = 32
"""Weights of a row with one peak: fewer cost space, more are rounded more coarsely."""
BITS = tuple(range(4, 17))
_INTEGERS, _PEAKS = ".int", ".peaks"
_ROOM = 1.02
"""Of a peak over the largest weight, which what rounding hands on to it may make larger."""
_FLOATS = ("F16", "BF16", "F32", "F64")


class Quantized(NamedTuple):
    """A matrix in few bits.

    Attributes:
      integers: [rows, groups, 32], int32; the last group of a row is filled with zeros.
      peaks: [rows, groups], float16 or float32.
      bits: of an integer. shape: of the matrix [rows, ...].
    """

    integers: Tensor
    peaks: Tensor
    bits: int
    shape: tuple[int, ...]

    def weights(self) -> Tensor:
        """The matrix, float32."""
        steps = self.peaks.float() / _largest(self.bits)
        rows = (self.integers.float() * steps[..., None]).flatten(1)
        return rows[:, : math.prod(self.shape[1:])].reshape(self.shape)

    def tensors(self, name: str) -> dict[str, Tensor]:
        """What stands in a file under the matrix's name."""
        chosen = self.integers[self.peaks > 0].flatten().numpy()
        packed = torch.from_numpy(_packed(chosen, self.bits))
        return {f"{name}{_INTEGERS}{self.bits}": packed, f"{name}{_PEAKS}": self.peaks}


def quantized(matrix: Tensor, bits: int, moments: Tensor | None = None) -> Quantized:
    """A matrix in few bits.

    With the second moments of what the matrix is multiplied by, each column's rounding errors are
    made up for by the columns that are not yet rounded (GPTQ: Frantar et al. 2022, equations 2 and
    3, the columns in the order of falling moments): the products stay close, where single weights
    could be closer. Without, each weight is rounded to the nearest.

    Args:
      matrix: [rows, ...].
      bits: one of `BITS`.
      moments: [columns, columns], positive definite; columns are those of the matrix flattened.

    Raises:
      InputError: `bits` is none of these.
    """
    if bits not in BITS:
        raise InputError(f"weights have {BITS[0]} to {BITS[-1]} bits; got {bits}")
    rows = matrix.detach().double().flatten(1)
    room = _ROOM if moments is not None else 1.0 + 2.0**-10  # half precision may round down
    peaks = (_grouped(rows).abs().amax(-1) * room).half()
    steps = (peaks.double() / _largest(bits)).repeat_interleave(GROUP, 1)[:, : rows.shape[1]]
    if moments is None:
        whole = _nearest(rows, steps, bits)
    else:
        whole = _with_feedback(rows, steps, bits, moments.double())
    return Quantized(_grouped(whole).int(), peaks, bits, tuple(matrix.shape))


def _nearest(weights: Tensor, steps: Tensor, bits: int) -> Tensor:
    """Integers; 0 where the step is 0."""
    whole = torch.where(steps > 0, weights / steps.clamp_min(1e-300), 0.0).round()
    return whole.clamp(-_largest(bits), _largest(bits))


def _with_feedback(rows: Tensor, steps: Tensor, bits: int, moments: Tensor) -> Tensor:
    """Integers [rows, columns]; `moments` [columns, columns]."""
    order = torch.argsort(moments.diagonal(), descending=True)
    rows, steps, inverse = rows[:, order].clone(), steps[:, order], torch.argsort(order)
    ahead = torch.linalg.cholesky(
        torch.cholesky_inverse(torch.linalg.cholesky(moments[order][:, order])), upper=True
    )
    whole = torch.zeros_like(rows)
    for column in range(rows.shape[1]):
        step = steps[:, column]
        whole[:, column] = _nearest(rows[:, column], step, bits)
        off = (rows[:, column] - whole[:, column] * step) / ahead[column, column]
        rows[:, column + 1 :] -= off[:, None] * ahead[column, column + 1 :]
    return whole[:, inverse]


# -- in a file -------------------------------------------------------------------------------------


def read_weights(file: Any, stored: Mapping[str, str], expected: Mapping[str, Any]) -> Any:
    """Weights from an open safetensors file, if they are those that are expected.

    Args:
      file: from `safetensors.safe_open`.
      stored: names in the model and, of each, the name in the file.
      expected: shapes by names in the model.

    Returns:
      A dictionary of tensors: float32 where there are few bits, else as they stand there.

    Raises:
      InputError: they have other names, shapes or types, or are not finite.
    """
    few = {name: found for name in stored if (found := _few_bits(name)) is not None}
    few = {n: (w, b) for n, (w, b) in few.items() if w in expected and w + _PEAKS in stored}
    parts = few.keys() | {w + _PEAKS for w, _ in few.values()}
    known = {name for name in stored if name not in parts} | {w for w, _ in few.values()}
    for name in sorted(known ^ expected.keys()):
        what = "is not in the weights" if name in expected else "is not in the model"
        raise InputError(f"{name} {what} that the manifest describes")
    tensors = {}
    for name in stored.keys() - parts:
        part = file.get_slice(stored[name])
        if tuple(part.get_shape()) != expected[name] or part.get_dtype() not in _FLOATS:
            raise InputError(
                f"{name} is {part.get_dtype()} of shape {tuple(part.get_shape())}; the manifest "
                f"describes {expected[name]}"
            )
        tensors[name] = file.get_tensor(stored[name])
    for name, (weight, bits) in few.items():
        packed, peaks = (file.get_tensor(stored[n]) for n in (name, weight + _PEAKS))
        tensors[weight] = _unpacked(weight, packed, peaks, bits, expected[weight]).weights()
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise InputError(f"{name} is not finite")
    return tensors


def _few_bits(name: str) -> tuple[str, int] | None:
    """The matrix's name and the number of bits, if this is the name of integers."""
    weight, found, bits = name.rpartition(_INTEGERS)
    if not found or not bits.isdecimal() or int(bits) not in BITS:
        return None
    return weight, int(bits)


def _unpacked(
    name: str, packed: Tensor, peaks: Tensor, bits: int, shape: tuple[int, ...]
) -> Quantized:
    """A matrix from its two tensors.

    Raises:
      InputError: they do not fit the shape.
    """
    groups = (shape[0], -(-math.prod(shape[1:]) // GROUP)) if len(shape) > 1 else None
    if tuple(peaks.shape) != groups or peaks.dtype not in (torch.float16, torch.float32):
        raise InputError(
            f"{name + _PEAKS} is {peaks.dtype} of shape {tuple(peaks.shape)}; it must have one "
            f"float16 or float32 for each {GROUP} weights of a row: shape {groups}"
        )
    count = int((peaks > 0).sum()) * GROUP
    size = -(-count * bits // 8)
    if tuple(packed.shape) != (size,) or packed.dtype != torch.uint8:
        raise InputError(
            f"{name + _INTEGERS}{bits} is {packed.dtype} of shape {tuple(packed.shape)}; {count} "
            f"integers of {bits} bits are {size} bytes"
        )
    integers = torch.zeros((*peaks.shape, GROUP), dtype=torch.int32)
    integers[peaks > 0] = torch.from_numpy(_integers(packed.numpy(), bits, count)).reshape(
        -1, GROUP
    )
    return Quantized(integers, peaks, bits, shape)


def _packed(integers: Any, bits: int) -> Any:
    """Bytes of signed integers of so many bits, the highest bit first."""
    unsigned = (integers + 2 ** (bits - 1)).astype(">u2")
    each = np.unpackbits(unsigned.view(np.uint8)).reshape(-1, 16)[:, 16 - bits :]
    return np.packbits(each)


def _integers(packed: Any, bits: int, count: int) -> Any:
    """The inverse of `_packed`, int32."""
    each = np.unpackbits(packed, count=count * bits).reshape(-1, bits)
    filled = np.zeros((count, 16), np.uint8)
    filled[:, 16 - bits :] = each
    return np.packbits(filled).view(">u2").astype(np.int32) - 2 ** (bits - 1)


def _largest(bits: int) -> int:
    return 2 ** (bits - 1) - 1


def _grouped(rows: Tensor) -> Tensor:
    """[rows, groups, 32] of [rows, columns]; the last group is filled with zeros."""
    return pad(rows, (0, -rows.shape[1] % GROUP)).unflatten(1, (-1, GROUP))
