"""Normal equations of blocks (windows, stretches of a recording): fitted to all but a few of them,
these are predicted."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from orbisim.evidence import Blocks, weights
from orbisim.host.deadline import NEVER, Deadline
from orbisim.shooting.regress import Normal

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Stack(NamedTuple):
    """Blocks as arrays. gram: [B, C, C]. moment: [B, C]. square, data: [B]."""

    gram: Floats
    moment: Floats
    square: Floats
    data: Floats


@dataclasses.dataclass(frozen=True, eq=False)
class Data:
    """What a selection goes by.

    Attributes:
      blocks: normal equations of each. folds: [B] number of the part that a block is left out with.
      counts: how their data count. weight: [B] by which they count in fits.
      deadline: when a selection ends with what it has.
    """

    blocks: tuple[Normal, ...]
    folds: Ints
    counts: Blocks
    weight: Floats
    deadline: Deadline = NEVER

    @functools.cached_property
    def stack(self) -> Stack:
        """The blocks as arrays."""
        return Stack(
            np.array([one.gram for one in self.blocks]),
            np.array([one.moment for one in self.blocks]),
            np.array([one.square for one in self.blocks]),
            np.array([float(max(one.count, 1)) for one in self.blocks]),
        )

    @property
    def rate(self) -> float:
        """Share of the data that counts as independent."""
        return self.counts.count / max(float(self.stack.data.sum()), 1.0)

    @functools.cached_property
    def others(self) -> tuple[Floats, Floats]:
        """[F, C, C] and [F, C]: gram and moment of all blocks but those of each fold, weighed."""
        weight = self.weight[:, None] * (self.folds[:, None] != np.arange(self.folds.max() + 1))
        gram = weight.T @ self.stack.gram.reshape(len(weight), -1)
        return gram.reshape(-1, *self.stack.gram.shape[1:]), weight.T @ self.stack.moment

    def whole(self) -> Normal:
        """All blocks, weighed."""
        stack, weight = self.stack, self.weight
        gram = np.einsum("b,bij->ij", weight, stack.gram)
        return Normal(
            gram, weight @ stack.moment, float(weight @ stack.square), int(stack.data.sum())
        )

    def reweighed(self, squares: Floats) -> Data:
        """With weights by what is left of each block, [B] mean squares."""
        again = dataclasses.replace(self, weight=weights(squares, self.counts))
        again.__dict__["stack"] = self.stack
        return again


def data_of(
    blocks: Sequence[Normal], counts: Blocks, folds: int = 10, deadline: Deadline = NEVER
) -> Data:
    """Blocks as they come, those of a signal that are next to each other in the same fold."""
    number = np.zeros(len(blocks), np.int64)
    for signal in np.unique(counts.signal):
        own = np.flatnonzero(counts.signal == signal)
        number[own] = np.arange(len(own)) * min(folds, len(own)) // len(own)
    data = Data(tuple(blocks), number, counts, np.ones(len(blocks)), deadline)
    return data.reweighed(np.array([one.square / max(one.count, 1) for one in blocks]))
