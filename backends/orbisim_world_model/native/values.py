"""Where a traced tensor's numbers stand: a buffer and the index of each number in it.

Whatever only moves numbers (views, slices, permutations, gathers) is done to the indices while
the code is written, and costs nothing when it runs.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import torch
from torch import Tensor


@dataclasses.dataclass(frozen=True, eq=False)
class Value:
    """A tensor in the generated code.

    Attributes:
      buffer: C expression of a `float *`.
      index: [shape] where each number stands in the buffer.
    """

    buffer: str
    index: Tensor

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the tensor."""
        return tuple(self.index.shape)

    def moved(self, index: Tensor) -> Value:
        """The same numbers in other places."""
        return Value(self.buffer, index)


@dataclasses.dataclass(frozen=True)
class Access:
    """How a loop nest reads a value.

    Attributes:
      buffer: C expression.
      offset, strides: of the index, when it is affine in the loop variables.
      table: the index of each element otherwise.
    """

    buffer: str
    offset: int
    strides: tuple[int, ...]
    table: tuple[int, ...] = ()


def accesses(shape: tuple[int, ...], values: list[Value]) -> tuple[tuple[int, ...], list[Access]]:
    """Loop sizes and accesses for values broadcast to a shape; loops are merged where possible."""
    spread = [value.index.expand(shape) for value in values]
    found = [_affine(value.buffer, index) for value, index in zip(values, spread, strict=True)]
    if any(access is None for access in found):
        flat = []
        for value, index in zip(values, spread, strict=True):
            line = _affine(value.buffer, index.reshape(-1))
            flat.append(line or Access(value.buffer, 0, (), tuple(index.reshape(-1).tolist())))
        return (int(spread[0].numel()),), flat
    return _merged(shape, [access for access in found if access is not None])


def _affine(buffer: str, index: Tensor) -> Access | None:
    """The access if the index is an offset plus strides times loop variables."""
    if not index.numel():
        return Access(buffer, 0, tuple(0 for _ in index.shape))
    offset = int(index.reshape(-1)[0])
    strides = []
    rebuilt = torch.full(index.shape, offset)
    for axis, size in enumerate(index.shape):
        step = int(index.select(axis, 1).reshape(-1)[0]) - offset if size > 1 else 0
        strides.append(step)
        shape = [1] * index.dim()
        shape[axis] = size
        rebuilt = rebuilt + step * torch.arange(size).reshape(shape)
    return Access(buffer, offset, tuple(strides)) if torch.equal(rebuilt, index) else None


def _merged(shape: tuple[int, ...], found: list[Access]) -> tuple[tuple[int, ...], list[Access]]:
    """Without loops of one turn, and with neighbouring loops joined where all strides allow it."""
    axes = [axis for axis, size in enumerate(shape) if size > 1]
    sizes: list[int] = []
    strides: list[list[int]] = [[] for _ in found]
    for axis in axes:
        joins = bool(sizes) and all(
            kept[-1] == access.strides[axis] * shape[axis]
            for kept, access in zip(strides, found, strict=True)
        )
        for kept, access in zip(strides, found, strict=True):
            if joins:
                kept[-1] = access.strides[axis]
            else:
                kept.append(access.strides[axis])
        if joins:
            sizes[-1] *= shape[axis]
        else:
            sizes.append(shape[axis])
    accesses_ = [
        Access(access.buffer, access.offset, tuple(kept))
        for access, kept in zip(found, strides, strict=True)
    ]
    return tuple(sizes), accesses_


def contiguous(buffer: str, offset: int, shape: Any) -> Value:
    """A value whose numbers stand one after the other."""
    count = 1
    for size in shape:
        count *= int(size)
    return Value(buffer, (offset + torch.arange(count)).reshape(tuple(shape)))
