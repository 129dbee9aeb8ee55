"""`DifferentiableStep`: a learned step with gradients, backward and forward, as graphs on a GPU.

Of a rollout's steps nothing is kept but their inputs; what the backward pass of a step needs is
computed again when it is its turn (Chen et al., "Training deep nets with sublinear memory cost",
2016), so that the memory of a rollout grows by a state a step. Each of the three, the step, its
backward pass and its derivative along a direction, is one CUDA graph for each number of worlds.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.autograd.function import once_differentiable

from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.graphs import Graphed, current
from orbisim_world_model.stepper import Compiler, cause, compiler_options

Tensors = tuple[Tensor, ...]
Flat = Callable[..., Tensors]
_FIELDS = len(Entities._fields)
_GRAPHS = 2
"""How many shapes keep their graphs."""


class DifferentiableStep:
    """A model's step in single precision; gradients reach states, memory, controls, descriptors.

    Args:
      model: in evaluation mode; it is not changed.
      device: where it is.
      compiler: how torch compiles the step and its backward pass, on a GPU; None does not.
        Derivatives along a direction (forward mode) are not compiled: torch cannot.
    """

    def __init__(
        self, model: Dynamics, device: torch.device, compiler: Compiler | None = None
    ) -> None:
        self.model, self.device = model, device
        self._compiler = compiler if device.type == "cuda" else None
        self._slots: dict[Any, _Slot] = {}

    def __call__(
        self, x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        """The state after `x` (`completed`), and the memory."""
        present = tuple(f is not None for f in context)
        given = (*x, memory, control, *(f for f in context if f is not None))
        key = (present, *((tuple(t.shape), t.dtype) for t in given))
        if key not in self._slots:
            if len(self._slots) >= _GRAPHS:
                self._slots.pop(next(iter(self._slots)))
            self._slots[key] = _Slot(self._flat(present), given, self.device, self._compiler)
        found = _Replayed.apply(self._slots[key], *given)
        return Entities(*found[:_FIELDS]), found[_FIELDS]

    @property
    def recorded(self) -> bool:
        """Whether all that was asked for so far is played back from graphs."""
        graphs = [graph for slot in self._slots.values() for graph in slot.graphs.values()]
        return bool(graphs) and all(graph.recorded for graph in graphs)

    def _flat(self, present: Sequence[bool]) -> Flat:
        """The step from tensors to tensors; of a context's fields, those that are there."""

        def step(*given: Tensor) -> Tensors:
            *fields, memory, control = given[: _FIELDS + 2]
            rest = iter(given[_FIELDS + 2 :])
            context = Context(*(next(rest) if there else None for there in present))
            after = self.model(Entities(*fields), memory, control, context)
            return (*after.state, after.memory)

        return step


class _Slot:
    """Fixed tensors of one shape and what works on them, made when first needed."""

    def __init__(
        self, step: Flat, given: Tensors, device: torch.device, compiler: Compiler | None
    ) -> None:
        self.device, self._plain, self._step = device, step, step
        self._given = [_own(t) for t in given]
        if compiler is not None:
            options = compiler_options(compiler)
            self._step = torch.compile(step, dynamic=False, fullgraph=True, options=options)
        self._along: list[Tensor] = []
        self._back: list[Tensor] = []
        self.graphs: dict[str, Graphed] = {}

    def forward(self, given: Tensors) -> Tensors:
        """The step."""
        return self._run("forward", self._forward, given)

    def backward(self, given: Tensors, back: Sequence[Tensor | None]) -> Tensors:
        """Gradients of all that is given, from those of what came out."""
        if not self._back:
            self._back = [torch.zeros_like(t) for t in self.forward(given)]
        self._load(self._back, back)
        return self._run("backward", self._backward, given)

    def tangent(self, given: Tensors, along: Sequence[Tensor | None]) -> Tensors:
        """The derivative of what comes out along a direction of what is given."""
        if not self._along:
            self._along = [torch.zeros_like(t) for t in self._given]
        self._load(self._along, along)
        return self._run("tangent", self._tangent, given)

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _load(self, mine: list[Tensor], given: Sequence[Tensor | None]) -> None:
        for target, value in zip(mine, given, strict=True):
            if value is None:
                target.zero_()
            else:
                target.copy_(value)

    def _run(self, name: str, function: Callable[[], Tensors], given: Tensors) -> Tensors:
        """What a function makes of what is given, in tensors that no later run writes to."""
        self._load(self._given, given)
        with current(self.device):
            if name not in self.graphs:
                self._try(function)
                self.graphs[name] = Graphed(function, lambda: None, self.device.type == "cuda")
            found: Tensors = self.graphs[name]()
        return tuple(t.clone() for t in found)

    def _try(self, function: Callable[[], Tensors]) -> None:
        """Compiles, or sees that this fails."""
        if self._step is self._plain:
            return
        try:
            function()
        except Exception as error:  # compilers fail in many ways; the step itself does not
            warnings.warn(f"gradients not compiled, they are slower: {cause(error)}", stacklevel=6)
            self._step = self._plain

    def _forward(self) -> Tensors:
        with torch.no_grad():
            return self._step(*self._given)

    def _backward(self) -> Tensors:
        with torch.enable_grad():
            leaves = [t.detach().requires_grad_() for t in self._given]
            found = self._step(*leaves)
            pairs = [(t, g) for t, g in zip(found, self._back, strict=True) if t.requires_grad]
            ends, grads = zip(*pairs, strict=True)
            return torch.autograd.grad(
                ends, leaves, grads, allow_unused=True, materialize_grads=True
            )

    def _tangent(self) -> Tensors:
        # a level is entered already: nothing is asked for along a direction without one
        with torch.no_grad(), forward_ad._set_fwd_grad_enabled(True):
            duals = (
                forward_ad.make_dual(t, d) for t, d in zip(self._given, self._along, strict=True)
            )
            ends = [forward_ad.unpack_dual(t) for t in self._plain(*duals)]
            return tuple(
                torch.zeros_like(end.primal) if end.tangent is None else end.tangent.clone()
                for end in ends
            )


def _own(given: Tensor) -> Tensor:
    return given.detach().clone(memory_format=torch.contiguous_format)


class _Replayed(torch.autograd.Function):
    """A slot's step, for torch's two ways to differentiate."""

    @staticmethod
    def forward(ctx: Any, slot: _Slot, *given: Tensor) -> Tensors:
        ctx.slot = slot
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*given)
        ctx.save_for_forward(*given)
        return slot.forward(given)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator]
    def backward(ctx: Any, *back: Tensor | None) -> Any:
        return (None, *ctx.slot.backward(ctx.saved_tensors, back))

    @staticmethod
    def jvp(ctx: Any, _: None, *along: Tensor | None) -> Any:
        return ctx.slot.tangent(ctx.saved_tensors, along)
