"""`NativeStep`: one control step of one world, from and to MuJoCo's coordinates."""

from __future__ import annotations

import ctypes
import itertools
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context
from orbisim_world_model.native.compiler import compiled
from orbisim_world_model.native.translate import Translator, simplified

Floats = npt.NDArray[np.float32]
_LINE = 16
"""Numbers in a line of a cache."""
_LARGEST = 1e6
"""A number, in the units of MuJoCo's coordinates, from which on torch has to step: no scene of a
learned model has such numbers, and products of them may no longer be finite."""
_Pointer = ctypes.POINTER(ctypes.c_float)


class NativeStep:
    """Steps (qpos, qvel, act, memory) of one world under a control.

    The code is right for finite numbers only: products with a constant zero are left out of it, and
    the compiler's fast arithmetic may turn a NaN into a bound. Inputs are looked at beforehand.

    Args:
      model: in evaluation mode, float32, on the CPU.
      context: descriptors of the scene, for one world.

    Raises:
      MissingDependencyError: there is no C compiler.
      UntranslatableError: the model has an operation that is not known.
    """

    def __init__(self, model: Dynamics, context: Context) -> None:
        layout = model.layout
        memory = model.initial_memory(1).detach().clone()
        example = [torch.zeros(1, n) for n in (layout.nq, layout.nv, layout.na, layout.nu)]
        for adr in layout.object_q:
            example[0][0, adr + 3] = 1.0
        translator = Translator(simplified(_traced(model, context, [*example, memory])))
        outputs = translator.run()
        writer = translator.writer
        results = [writer.elementwise(out.shape, "{0}", [out]) for out in outputs]
        self._function = compiled(writer.source(), careful=model.contacts is not None)
        self._constants = _aligned(torch.cat(writer.constants).numpy())
        self._workspace = _aligned(np.zeros(max(writer.workspace, 1), np.float32))
        self._given, self._inputs = _side_by_side([tuple(t.shape) for t in (*example, memory)])
        pointers = [array.ctypes.data_as(_Pointer) for array in self._inputs]
        self._arguments: tuple[Any, ...] = (
            self._constants.ctypes.data_as(_Pointer),
            self._workspace.ctypes.data_as(_Pointer),
            (_Pointer * len(pointers))(*pointers),
        )
        self._results = [self._workspace[_span(r.index)].reshape(r.shape) for r in results]

    def __call__(self, *inputs: Any) -> list[Floats] | None:
        """qpos, qvel, act and memory after one step.

        None if an input has a number that is not finite, or of which products may not be.

        Args:
          *inputs: qpos [1, nq], qvel [1, nv], act [1, na], control [1, nu], memory [1, ...].
        """
        for mine, given in zip(self._inputs, inputs, strict=True):
            mine[...] = given
        if not np.maximum.reduce(np.abs(self._given)) < _LARGEST:  # of NaN this is true
            return None
        self._function(*self._arguments)
        return [result.copy() for result in self._results]


def _traced(model: Dynamics, context: Context, example: list[Tensor]) -> Any:
    from torch._decomp import core_aten_decompositions
    from torch.fx.experimental.proxy_tensor import make_fx

    layout = model.layout

    def step(qpos: Tensor, qvel: Tensor, act: Tensor, control: Tensor, memory: Tensor) -> Any:
        x = model.completed(layout.split(qpos, qvel, act))
        after = model(x, memory, control, context)
        return (*layout.join(after.state), after.memory)

    with torch.no_grad():
        traced = make_fx(step, decomposition_table=core_aten_decompositions())(*example)
    traced.graph.eliminate_dead_code()
    return traced


def _aligned(values: Floats) -> Floats:
    """A copy that begins at a multiple of 64 bytes, so that no vector lies across two lines of a
    cache: products of three rows are 1.5 times as fast."""
    room = np.empty(len(values) + _LINE, np.float32)
    first = -(room.ctypes.data // room.itemsize) % _LINE
    room[first : first + len(values)] = values
    return room[first : first + len(values)]


def _side_by_side(shapes: list[tuple[int, ...]]) -> tuple[Floats, list[Floats]]:
    """Zeros, and arrays of these shapes in it, each from the beginning of a line of a cache on."""
    sizes = [math.prod(shape) for shape in shapes]
    starts = [0, *itertools.accumulate(size + -size % _LINE for size in sizes)]
    whole = _aligned(np.zeros(starts[-1], np.float32))
    parts = zip(starts[:-1], sizes, shapes, strict=True)
    return whole, [whole[start : start + size].reshape(shape) for start, size, shape in parts]


def _span(index: Tensor) -> slice:
    first = int(index.reshape(-1)[0]) if index.numel() else 0
    return slice(first, first + index.numel())
