"""Work on a GPU that is recorded once and then started as a whole."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

_WARM = 3
"""Runs before the recording: libraries choose their algorithms and compilers run in the first."""


class Recorded:
    """A function of tensors as a CUDA graph: the same kernels, without starting each by itself.

    Args:
      work: of tensors on a GPU to tensors there, in which the host waits for nothing: no copy to
        or from it, no shape that depends on values. given: such tensors; later ones have the same
        shapes. before: another recording, never played back at the same time, whose memory is used
        again.
    """

    def __init__(
        self,
        work: Callable[..., tuple[Tensor, ...]],
        given: tuple[Tensor, ...],
        before: Recorded | None = None,
    ) -> None:
        self._given = tuple(x.detach().clone() for x in given)
        device = given[0].device
        aside = torch.cuda.Stream(device)
        aside.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(aside), torch.no_grad():
            for _ in range(_WARM):
                work(*self._given)
        torch.cuda.current_stream(device).wait_stream(aside)
        self._graph = torch.cuda.CUDAGraph()
        pool = None if before is None else before._graph.pool()
        with torch.no_grad(), torch.cuda.graph(self._graph, pool=pool):
            self._found = work(*self._given)

    def __call__(self, given: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """What the work makes of tensors; the next call, of any recording, overwrites it."""
        for place, value in zip(self._given, given, strict=True):
            place.copy_(value)
        self._graph.replay()
        return self._found
