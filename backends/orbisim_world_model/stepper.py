"""`Stepper`: the learned step without gradients, as fast as the device allows."""

from __future__ import annotations

import copy
import dataclasses
import functools
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from orbisim.errors import EngineError
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.graphs import Graphed
from orbisim_world_model.network.folded import FoldedNetwork
from orbisim_world_model.network.objects import ObjectCentricNetwork

Compiler = Literal["fused", "joined", "inlined", "tuned"]
Step = Callable[[Entities, Tensor, Tensor, Context], tuple[Entities, Tensor]]
_FUSED = {"force_pointwise_cat": True}
_INLINED = {
    **_FUSED,
    "realize_reads_threshold": 64,
    "realize_opcount_threshold": 400,
    "realize_acc_reads_threshold": 128,
}
_OPTIONS: dict[Compiler, dict[str, Any]] = {
    "fused": _FUSED,
    "joined": {**_FUSED, "combo_kernels": True},
    "inlined": _INLINED,
    "tuned": {**_INLINED, "max_autotune": True, "coordinate_descent_tuning": True},
}
"""Options of torch's compiler: features joined within kernels; kernels that do not depend on each
other launched as one, half as many for one world; computed again rather than stored; products
chosen by measurement and fused with what follows them."""
_GRAPHS = 4
"""How many batch sizes keep their CUDA graph."""
_RECOMPILATIONS = 1000
"""Batch sizes that torch may compile the step for, in all; its own limit is 8."""
_FOLDED_UP_TO = 1024
"""Worlds up to which combined weights are used where torch does not compile the step. On an H200
they take 0.60 ms against 0.61 at one world and 3.15 against 2.56 at 8,192, where the scores of
pairs, which torch then computes term by term, take more than the products that are saved."""


@dataclasses.dataclass(frozen=True)
class Speedups:
    """What is done to make a step fast; each can be switched off to measure it.

    Attributes:
      folded: compute the network with its weights combined (`network.folded`); None: where that
        is faster.
      precision: of the network, on a GPU; physics is always computed in float32.
      kernels: compute the network by kernels of our own (`network.fused`), on a GPU in fp16, where
        they suit it.
      variances: compute `Spread` by a kernel of our own, too.
      compiled: how torch compiles the step, if it can; None does not compile.
      graphed: one CUDA graph for each number of worlds.
    """

    folded: bool | None = None
    precision: Literal["fp16", "bf16", "fp32"] = "fp16"
    kernels: bool = True
    variances: bool = True
    compiled: Compiler | None = "joined"
    graphed: bool = True


_TYPES = {"fp16": torch.float16, "bf16": torch.bfloat16, "fp32": torch.float32}


class Stepper:
    """Steps a batch of worlds; on a GPU through one CUDA graph for each number of worlds.

    Args:
      model: in evaluation mode.
      device: where to compute.
      speedups: what to do for speed; without a GPU, weights are combined and no more. After
        torch once failed to compile the step, it is not asked again.
    """

    def __init__(
        self, model: Dynamics, device: torch.device, speedups: Speedups | None = None
    ) -> None:
        self.device, self.speedups = device, speedups or Speedups()
        self.on_gpu = device.type == "cuda"
        self.model = self._made(model, folded=self.speedups.folded is not False)
        self._many = self.model  # for many worlds, where torch does not compile
        if self.on_gpu and self.speedups.folded is None:
            self._many = self._made(model, folded=False)
        self._kernels = self._with_kernels(model) if self.on_gpu else None
        self._compiler = self.speedups.compiled
        self._graphs: dict[tuple[int, bool], Slot] = {}

    def _made(self, model: Dynamics, folded: bool) -> Dynamics:
        made = copy.deepcopy(model).to(self.device).eval()
        if folded and isinstance(made.network, ObjectCentricNetwork):
            made.network = FoldedNetwork(made.network)
        made.requires_grad_(False)
        if self.on_gpu:
            made.network.to(_TYPES[self.speedups.precision])
        return made

    @property
    def fastest(self) -> Dynamics:
        """The model that is used for many worlds, to be compiled with what is around it."""
        return self.model if self._kernels is None else self._kernels

    def _with_kernels(self, model: Dynamics) -> Dynamics | None:
        """The model with its network in kernels of our own, where they suit it."""
        if not self.speedups.kernels or self.speedups.precision != "fp16":
            return None
        try:
            from orbisim_world_model.network.fused import FusedNetwork, FusedSpread
        except ImportError:  # a torch without triton
            return None
        if not FusedNetwork.suits(model.network):
            return None
        made = self._made(model, folded=False)
        made.network = FusedNetwork(model.network).to(self.device, torch.float16)
        own = self.speedups.variances and made.spread is not None
        if own and FusedSpread.suits(made.sizes):
            made.spread = FusedSpread(made.spread, made.sizes).to(self.device)
        return made.requires_grad_(False)

    def __call__(
        self, x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        """One step; the result's tensors belong to the caller.

        Args:
          context: for many steps, as `described` gives it.
        """
        with torch.no_grad():
            if not self.on_gpu:
                step = self.model(x, memory, control, context)
                return step.state, step.memory
            with torch.cuda.device(self.device):
                slot = self.prepared(x, memory, control, context)
                slot.load(x, memory, control, context)
                state, h = slot.run()
                return Entities(*(field.clone() for field in state)), h.clone()

    def described(self, context: Context) -> Context:
        """The same with what the model makes of descriptors alone, to be handed to many steps.

        On a GPU it is the context itself: each graph describes for its own model what it loads.
        """
        if self.on_gpu:
            return context
        with torch.no_grad():
            return _described(self.model, context)

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
        key = len(x.pos), _shared(context)
        if key not in self._graphs:
            if len(self._graphs) >= _GRAPHS:
                self._graphs.pop(next(iter(self._graphs)))
            with torch.no_grad():
                self._graphs[key] = self._slot(x, memory, control, context)
        return self._graphs[key]

    def _slot(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> Slot:
        while True:
            model = self.model if self._kernels is None else self._kernels
            describe = functools.partial(_described, model)
            given = (x, memory, control, describe(context))
            compiler = self._compiler
            if compiler is None and model is self.model and len(x.pos) > _FOLDED_UP_TO:
                model = self._many
            step = plain_step(model) if compiler is None else compiled_step(model, compiler)
            try:
                with torch._dynamo.config.patch(recompile_limit=_RECOMPILATIONS):
                    step(*given)
                if self.device.type == "cuda":  # what fails on the device fails here
                    torch.cuda.synchronize(self.device)
            except Exception as error:  # compilers fail in many ways; the step itself does not
                if compiler is None and self._kernels is None:
                    raise
                if not answers(self.device):
                    raise EngineError(
                        f"{self.device} no longer answers after the first step of {len(x.pos)} "
                        f"worlds ({cause(error)}), and nothing in this process can use it any "
                        "more: begin anew with compiled=False, which leaves torch's compiler out, "
                        "or with half=False, which leaves our own kernels out"
                    ) from error
                if compiler == "joined":  # the youngest of torch's options, and the least needed
                    self._compiler = "fused"
                    continue
                what = "compiled" if compiler is not None else "computed by our own kernels"
                warnings.warn(f"step not {what}, it is slower: {cause(error)}", stacklevel=5)
                if compiler is not None:
                    self._compiler = None
                else:
                    self._kernels, self._compiler = None, self.speedups.compiled
                continue
            return Slot(step, describe, compiler is not None, self.speedups.graphed, *given)


def answers(device: torch.device) -> bool:
    """Whether a device still computes: after an illegal access to its memory it does not, and what
    is tried next would hide what went wrong first."""
    try:
        return bool(torch.zeros(1, device=device).item() == 0)
    except RuntimeError:
        return False


def _shared(context: Context) -> bool:
    """Whether all worlds have the same descriptors, by how they lie in memory."""
    fields = (context.attributes, context.world, context.parts)
    return all(len(field) > 1 and field.stride(0) == 0 for field in fields if field is not None)


def _described(model: Dynamics, context: Context) -> Context:
    """See `Dynamics.described`; of descriptors that all worlds share, once."""
    if not _shared(context):
        return model.described(context)
    parts = None if context.parts is None else context.parts[:1]
    one = Context(context.attributes[:1], context.world[:1], None, parts)
    return context._replace(scales=model.described(one).scales)


class Slot:
    """Fixed tensors of one batch size and the graph that works on them.

    Args:
      step: what the graph is made of.
      describe: adds to a context what is computed from it once (see `Dynamics.described`).
      compiled: whether torch compiled it.
      graphed: whether to capture a graph.
      x, memory, control, context: values to begin with.
    """

    def __init__(
        self,
        step: Step,
        describe: Callable[[Context], Context],
        compiled: bool,
        graphed: bool,
        x: Entities,
        memory: Tensor,
        control: Tensor,
        context: Context,
    ) -> None:
        self.compiled = compiled
        self.x = Entities(*(field.clone() for field in x))
        self.memory, self.control = memory.clone(), control.clone()
        self._describe, self._given = describe, context
        self.context = Context(*(None if f is None else f.clone() for f in context))
        given = (self.x, self.memory, self.control, self.context)
        self.run: Any = Graphed(lambda: step(*given), lambda: None, graphed)

    def load(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> None:
        """Copies inputs to where the graph reads them."""
        for mine, given in zip(self.x, x, strict=True):
            mine.copy_(given)
        self.memory.copy_(memory)
        self.control.copy_(control)
        if context is not self._given:  # a rollout hands over the same one at every step
            self._given = context
            for mine, given in zip(self.context, self._describe(context), strict=True):
                if mine is not None and given is not None:
                    mine.copy_(given)


def plain_step(model: Dynamics) -> Step:
    """The step as a function that gives state and memory."""

    def step(
        x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        after = model(x, memory, control, context)
        return after.state, after.memory

    return step


def flat_step(model: Dynamics) -> Callable[..., tuple[Tensor, ...]]:
    """The step of tensors one by one: entities, memory, control and the fields of the context."""
    fields = len(Entities._fields)

    def step(*given: Any) -> tuple[Tensor, ...]:
        memory, control, *described = given[fields:]
        context = Context(*described)
        after = model(Entities(*given[:fields]), memory, control, context)
        return (*after.state, after.memory)

    return step


def compiled_step(model: Dynamics, compiler: Compiler = "fused") -> Step:
    """`plain_step` compiled by torch for the number of worlds that it is called with.

    What torch compiles gives tensors alone: torch 2.11 fails on named tuples that were made by
    `_replace` in the compiled code (an assertion without a message in its `side_effects.py`).
    """
    options = compiler_options(compiler)
    fast = torch.compile(flat_step(model), dynamic=False, fullgraph=True, options=options)

    def step(
        x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        *state, after = fast(*x, memory, control, *context)
        return Entities(*state), after

    return step


def compiler_options(compiler: Compiler) -> dict[str, Any]:
    """Options for torch's compiler, those that this version of torch has."""
    from torch._inductor import config

    return {k: v for k, v in _OPTIONS[compiler].items() if hasattr(config, k)}


def cause(error: BaseException) -> str:
    """Type, first line and place of an error; compilers' messages can be empty or pages long."""
    lines = [line.strip() for line in str(error).split("from user code:")[0].splitlines()]
    message = next((line for line in lines if line), "")
    frames = traceback.extract_tb(error.__traceback__)
    text = f"{type(error).__name__}: {message[:200]}"
    if not frames:
        return text
    last = frames[-1]
    where = "/".join(Path(last.filename).parts[-3:])
    return f"{text} (in {where} line {last.lineno}: {(last.line or '').strip()[:120]})"
