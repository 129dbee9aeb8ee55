"""`PolicyUpdate`: a policy's update by the gradient through a window of learned steps."""

from __future__ import annotations

import contextlib
import copy
import math
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor, nn

from orbisim.arguments import whole_number
from orbisim.errors import InputError
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.graphs import Graphed, current
from orbisim_world_model.network.folded import FoldedNetwork
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.optimizer import FlatAdamW
from orbisim_world_model.stepper import Compiler, cause, compiler_options

Objective = Callable[[Entities], Tensor]


class PolicyUpdate:
    """Forward, backward and the optimiser's step, on a GPU as one CUDA graph of compiled code.

    The loss is the mean over worlds of `loss` of the states at the window's end; the policy acts at
    every step of it. Products of the network are of tf32 on a GPU. Nothing is watched here: see
    what comes of a policy by `backend.rollout`.

    Args:
      model: the dynamics; it is not changed.
      policy: from the states of B worlds (`Entities`) to controls [B, nu], a module; its
        parameters become views of one vector (`FlatAdamW`).
      loss: from the states at the end to [B].
      context: descriptors of the worlds. device: where to compute.
      window: control steps, at least 1.
      rate: of AdamW. clip: largest norm of a gradient.
      compiler: how torch compiles; None does not.

    Attributes:
      optimizer: its `rate` may be changed between updates. A gradient that is not finite changes
        nothing, and is counted in `skipped`.

    Raises:
      InputError: the window or the rate makes no sense, or the policy has nothing to train; of a
        call, the states are of another number of worlds, or policy or loss give another shape.
    """

    def __init__(
        self,
        model: Dynamics,
        policy: nn.Module,
        loss: Objective,
        context: Context,
        device: torch.device,
        *,
        window: int,
        rate: float = 1e-3,
        clip: float = 1.0,
        compiler: Compiler | None = "joined",
    ) -> None:
        made = copy.deepcopy(model).to(device).eval()
        made.spread = None  # how far off it may be has no part in the loss
        if isinstance(made.network, ObjectCentricNetwork):
            made.network = FoldedNetwork(made.network)
        if not any(parameter.requires_grad for parameter in policy.parameters()):
            raise InputError("the policy has no parameters that ask for a gradient")
        if not (rate >= 0.0 and math.isfinite(rate)):
            raise InputError(f"rate must be a finite number of at least 0; got {rate!r}")
        self._model = made.requires_grad_(False).to(device)
        self._policy, self._loss, self._context = policy.to(device), loss, context
        self.window, self.device = whole_number("window", window, 1), device
        self.optimizer = FlatAdamW(self._policy, 0.0, clip)
        self.optimizer.rate.fill_(rate)
        self._compiler = compiler if device.type == "cuda" else None
        self._memory = self._model.initial_memory(len(context.attributes)).detach().clone()
        self._start: Entities | None = None
        self._run: Graphed | None = None

    def __call__(self, start: Entities) -> Tensor:
        """An update from these states, in as many worlds as the context has; gives the loss []."""
        worlds = len(self._context.attributes)
        if len(start.q) != worlds:
            raise InputError(f"states are of {len(start.q)} worlds; descriptors are of {worlds}")
        with torch.no_grad():
            if self._start is None:
                self._check(start, worlds)
                whole = self._model.completed(start)
                self._start = Entities(*(field.clone() for field in whole))
            else:
                for mine, given in zip(self._start, self._model.completed(start), strict=True):
                    mine.copy_(given)
        with _tf32(), current(self.device):
            if self._run is None:
                self._run = self._prepared()
            loss: Tensor = self._run()
        return loss.clone()

    def _check(self, start: Entities, worlds: int) -> None:
        """That policy and loss give what a step and a mean over worlds need."""
        x, controls = self._model.completed(start), (worlds, self._model.controls)
        for what, found, wanted in (
            ("policy gives controls", self._policy(x), controls),
            ("loss gives values", self._loss(x), (worlds,)),
        ):
            if tuple(found.shape) != wanted:
                raise InputError(f"the {what} of shape {tuple(found.shape)}; expected {wanted}")

    def _prepared(self) -> Graphed:
        saved = {name: tensor.clone() for name, tensor in self.optimizer.state().items()}

        def restore() -> None:
            self.optimizer.restore(saved)

        step: Any = self._moved
        if self._compiler is not None:
            options = compiler_options(self._compiler)
            step = torch.compile(self._moved, dynamic=False, fullgraph=True, options=options)
            try:
                self._update(step)
            except Exception as error:  # compilers fail in many ways; the step itself does not
                warnings.warn(f"update not compiled, it is slower: {cause(error)}", stacklevel=4)
                step = self._moved
            restore()
        return Graphed(lambda: self._update(step), restore, self.device.type == "cuda")

    def _moved(self, *given: Tensor) -> tuple[Tensor, ...]:
        """A step under the policy, from tensors to tensors."""
        *fields, memory = given
        x = Entities(*fields)
        after = self._model(x, memory, self._policy(x), self._context)
        return (*after.state, after.memory)

    def _update(self, step: Any) -> Tensor:
        assert self._start is not None
        self.optimizer.zero_grad()
        # a start that asks for its gradient, too, looks to the compiler like any later state
        now: tuple[Tensor, ...] = tuple(f.clone().requires_grad_() for f in self._start)
        now = (*now, self._memory)
        for _ in range(self.window):
            now = step(*now)
        loss = self._loss(Entities(*now[:-1])).mean()
        loss.backward()
        self.optimizer.step()
        return loss.detach()


@contextlib.contextmanager
def _tf32() -> Iterator[None]:
    """Products in tf32, where there is a GPU that has it."""
    matmul = torch.backends.cuda.matmul
    before, matmul.allow_tf32 = matmul.allow_tf32, True
    try:
        yield
    finally:
        matmul.allow_tf32 = before
