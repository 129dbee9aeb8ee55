"""`Stepper`: the learned step without gradients, as fast as the device allows."""

from __future__ import annotations

import copy
import dataclasses
import warnings
from typing import Any, Literal

import torch
from torch import Tensor

from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.graphs import Graphed
from orbisim_world_model.network.folded import FoldedNetwork
from orbisim_world_model.network.objects import ObjectCentricNetwork

Compiler = Literal["fused", "inlined", "tuned"]
_FUSED = {"force_pointwise_cat": True}
_INLINED = {
    **_FUSED,
    "realize_reads_threshold": 64,
    "realize_opcount_threshold": 400,
    "realize_acc_reads_threshold": 128,
}
_OPTIONS: dict[Compiler, dict[str, Any]] = {
    "fused": _FUSED,
    "inlined": _INLINED,
    "tuned": {**_INLINED, "max_autotune": True, "coordinate_descent_tuning": True},
}
"""Options of torch's compiler: features joined within kernels; computed again rather than stored;
products chosen by measurement and fused with what follows them."""
_GRAPHS = 4
"""How many batch sizes keep their CUDA graph."""
_RECOMPILATIONS = 1000
"""Batch sizes that torch may compile the step for, in all; its own limit is 8."""


@dataclasses.dataclass(frozen=True)
class Speedups:
    """What is done to make a step fast; each can be switched off to measure it.

    Attributes:
      folded: compute the network with its weights combined (`network.folded`).
      precision: of the network, on a GPU; physics is always computed in float32.
      compiled: how torch compiles the step; None does not compile.
      graphed: one CUDA graph for each number of worlds.
    """

    folded: bool = True
    precision: Literal["fp16", "bf16", "fp32"] = "fp16"
    compiled: Compiler | None = "fused"
    graphed: bool = True


_TYPES = {"fp16": torch.float16, "bf16": torch.bfloat16, "fp32": torch.float32}


class Stepper:
    """Steps a batch of worlds; on a GPU through one CUDA graph for each number of worlds.

    Args:
      model: in evaluation mode.
      device: where to compute.
      speedups: what to do for speed; without a GPU, weights are combined and no more.
    """

    def __init__(
        self, model: Dynamics, device: torch.device, speedups: Speedups | None = None
    ) -> None:
        self.device, self.speedups = device, speedups or Speedups()
        self.on_gpu = device.type == "cuda"
        self.model = copy.deepcopy(model).to(device).eval()
        if self.speedups.folded and isinstance(self.model.network, ObjectCentricNetwork):
            self.model.network = FoldedNetwork(self.model.network)
        self.model.requires_grad_(False)
        if self.on_gpu:
            self.model.network.to(_TYPES[self.speedups.precision])
        self._graphs: dict[int, Slot] = {}

    def __call__(
        self, x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        """One step; the result's tensors belong to the caller."""
        with torch.no_grad():
            if not self.on_gpu:
                step = self.model(x, memory, control, context)
                return step.state, step.memory
            with torch.cuda.device(self.device):
                slot = self.prepared(x, memory, control, context)
                slot.load(x, memory, control, context)
                state, h = slot.run()
                return Entities(*(field.clone() for field in state)), h.clone()

    def completed(self, x: Entities) -> Entities:
        """The state with the hand that follows from the joints."""
        with torch.no_grad():
            return self.model.completed(x)

    def initial_memory(self, batch: int) -> Tensor:
        """Memory when nothing is known of the past."""
        with torch.no_grad():
            return self.model.initial_memory(batch).to(self.device).clone()

    def prepared(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> Slot:
        """The graph for a number of worlds, made when it is first needed."""
        size = len(x.pos)
        if size not in self._graphs:
            if len(self._graphs) >= _GRAPHS:
                self._graphs.pop(next(iter(self._graphs)))
            with torch.no_grad():
                self._graphs[size] = Slot(self.model, self.speedups, x, memory, control, context)
        return self._graphs[size]


class Slot:
    """Fixed tensors of one batch size and the graph that works on them.

    Attributes:
      compiled: whether the graph is of a compiled step.
    """

    def __init__(
        self,
        model: Dynamics,
        speedups: Speedups,
        x: Entities,
        memory: Tensor,
        control: Tensor,
        context: Context,
    ) -> None:
        self.x = Entities(*(field.clone() for field in x))
        self.memory, self.control = memory.clone(), control.clone()
        self.context = Context(context.attributes.clone(), context.world.clone(), None)
        self.compiled = False
        given = (self.x, self.memory, self.control, self.context)
        if speedups.compiled is not None:
            fast = compiled_step(model, speedups.compiled)
            try:
                with torch._dynamo.config.patch(recompile_limit=_RECOMPILATIONS):
                    fast(*given)
                self.compiled = True
            except Exception as error:  # compilers fail in many ways; the step itself does not
                text = " ".join(str(error).split())[:200]
                warnings.warn(f"step not compiled, it is slower: {text}", stacklevel=4)
        step = fast if self.compiled else plain_step(model)
        self.run: Any = Graphed(lambda: step(*given), lambda: None, speedups.graphed)

    def load(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> None:
        """Copies inputs to where the graph reads them."""
        for mine, given in zip(self.x, x, strict=True):
            mine.copy_(given)
        self.memory.copy_(memory)
        self.control.copy_(control)
        self.context.attributes.copy_(context.attributes)
        self.context.world.copy_(context.world)


def plain_step(model: Dynamics) -> Any:
    """The step as a function of tensors alone, giving state and memory."""

    def step(
        x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        after = model(x, memory, control, context)
        return after.state, after.memory

    return step


def compiled_step(model: Dynamics, compiler: Compiler = "fused") -> Any:
    """`plain_step` compiled by torch for the number of worlds that it is called with."""
    from torch._inductor import config

    known = {k: v for k, v in _OPTIONS[compiler].items() if hasattr(config, k)}
    return torch.compile(plain_step(model), dynamic=False, fullgraph=True, options=known)
