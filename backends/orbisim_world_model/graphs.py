"""Runs a function of fixed tensors as one CUDA graph, or as it is where there is no GPU."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable
from typing import Any

import torch


def current(device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Makes a GPU the current one, as graphs and Triton's kernels need; a CPU needs nothing."""
    return torch.cuda.device(device) if device.type == "cuda" else contextlib.nullcontext()


class Graphed:
    """A function without arguments that reads and writes tensors that stay in place.

    Args:
      function: what to run; must not depend on the host.
      restore: undoes what the warm-up before the capture changed.
      enabled: whether to capture a graph (needs a GPU).
    """

    def __init__(
        self, function: Callable[[], Any], restore: Callable[[], None], enabled: bool
    ) -> None:
        self._function = function
        self._graph: Any = None
        if not enabled:
            return
        try:
            self._record(function)
        except RuntimeError as error:
            torch.cuda.synchronize()
            text = " ".join(str(error).split())[:200]
            warnings.warn(f"no CUDA graph, steps are slower: {text}", stacklevel=2)
        restore()

    def _record(self, function: Callable[[], Any]) -> None:
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(3):
                function()
        torch.cuda.current_stream().wait_stream(stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._result = function()
        self._graph = graph

    @property
    def recorded(self) -> bool:
        """Whether there is a graph."""
        return self._graph is not None

    def __call__(self) -> Any:
        """Runs it once; with a graph, the result's tensors are the same each time."""
        if self._graph is None:
            return self._function()
        self._graph.replay()
        return self._result
