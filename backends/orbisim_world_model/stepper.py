"""`Stepper`: the learned step without gradients, as fast as the device allows."""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor

from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.graphs import Graphed

_GRAPHS = 4
"""How many batch sizes keep their CUDA graph."""


class Stepper:
    """Steps a batch of worlds; on a GPU through one CUDA graph for each number of worlds.

    Args:
      model: in evaluation mode.
      device: where to compute.
      half: whether the network computes in half precision (GPU only); physics never does.
    """

    def __init__(self, model: Dynamics, device: torch.device, half: bool) -> None:
        self.device = device
        self.on_gpu = device.type == "cuda"
        self.model = copy.deepcopy(model).to(device).eval()
        self.model.requires_grad_(False)
        if half and self.on_gpu:
            self.model.network.half()
        self._graphs: dict[int, _Slot] = {}

    def __call__(
        self, x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        """One step; the result's tensors belong to the caller."""
        with torch.no_grad():
            if not self.on_gpu:
                step = self.model(x, memory, control, context)
                return step.state, step.memory
            with torch.cuda.device(self.device):
                slot = self._slot(x, memory, control, context)
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

    def _slot(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> _Slot:
        size = len(x.pos)
        if size not in self._graphs:
            if len(self._graphs) >= _GRAPHS:
                self._graphs.pop(next(iter(self._graphs)))
            self._graphs[size] = _Slot(self.model, x, memory, control, context)
        return self._graphs[size]


class _Slot:
    """Fixed tensors of one batch size and the graph that works on them."""

    def __init__(
        self, model: Dynamics, x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> None:
        self.x = Entities(*(field.clone() for field in x))
        self.memory, self.control = memory.clone(), control.clone()
        self.context = Context(context.attributes.clone(), context.world.clone(), None)

        def step() -> tuple[Entities, Tensor]:
            after = model(self.x, self.memory, self.control, self.context)
            return after.state, after.memory

        self.run: Any = Graphed(step, lambda: None, True)

    def load(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> None:
        for mine, given in zip(self.x, x, strict=True):
            mine.copy_(given)
        self.memory.copy_(memory)
        self.control.copy_(control)
        self.context.attributes.copy_(context.attributes)
        self.context.world.copy_(context.world)
