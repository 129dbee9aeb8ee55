"""Whether torch compiles the learned step on this machine, and what that brings.

`tools/bench_learned.py --only compile-check` runs it: dynamo alone, the automatic differentiation
on top, and the whole compiler, each with features alone, the network alone and the control step,
at one world and at 8,192. What fails prints the end of its full traceback. Times are of a CUDA
graph of our own, next to the same function uncompiled.
"""

from __future__ import annotations

import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch

LINES = 40
"""Of a traceback, its last ones."""
CASES = {
    "eager": ("step", "network", "features", "nested step"),
    "aot_eager": ("step", "network", "features"),
    "fused": ("step", "unfolded step"),
    "inductor": ("step", "network", "features"),
}
"""Parts by compiler, what matters most first. `fused` is inductor with the shipped options. The
nested step gives named tuples, which torch 2.11 cannot do once one was `_replace`d."""
EACH = 45
"""Most seconds for one case."""


def compile_check(model: Any, options: Any, inputs: Any, median: Any) -> dict[str, Any]:
    """Milliseconds or the cause of the failure, by compiler, part and number of worlds.

    Args:
      model: to check, as loaded.
      options: of tools/bench_learned.py; `patience` bounds the whole.
      inputs: makes a step's inputs for a stepper and a number of worlds.
      median: measures seconds of a call.
    """
    from orbisim_world_model.stepper import Speedups, Stepper, cause

    device = torch.device(options.device)
    torch._dynamo.config.verbose = True  # keeps the compiler's own lines in tracebacks
    _print_versions()
    began, found = time.perf_counter(), {}
    sizes = (1, min(8192, options.largest))
    for folded in (True, False):
        stepper = Stepper(model, device, Speedups(folded=folded, compiled=None))
        for worlds in (1, 64, 256, 1024, 4096, 8192):
            if worlds <= options.largest:
                given = inputs(stepper, worlds)
                name = f"plain {'folded' if folded else 'unfolded'} step {worlds}"
                found[name] = _timed(stepper.model, "step", given, None, options, median)
                print(name, found[name], flush=True)
    folding = Stepper(model, device, Speedups(folded=True, compiled=None))
    for compiler, part, worlds in [(c, p, n) for c, ps in CASES.items() for p in ps for n in sizes]:
        name = f"{compiler} {part} {worlds}"
        left = options.patience - (time.perf_counter() - began)
        if left < 1:
            print("out of time before", name, flush=True)
            break
        chosen = stepper if part == "unfolded step" else folding
        start = time.perf_counter()
        try:
            with torch.no_grad(), _within(int(min(left, EACH)) or 1):
                given = inputs(chosen, worlds)
                row = _timed(chosen.model, part, given, compiler, options, median)
            found[name] = {"ok": True, **row, "seconds": time.perf_counter() - start}
            print(name, "ok", found[name], flush=True)
        except Exception as error:  # any way in which a compiler fails is a finding
            lines = traceback.format_exc().splitlines()[-LINES:]
            found[name] = {"ok": False, "cause": cause(error), "traceback": lines}
            print(name, "FAILED", cause(error), *lines, sep="\n", flush=True)
    return found


def _print_versions() -> None:
    import shutil
    import sysconfig
    from pathlib import Path

    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    try:
        import triton

        version = triton.__version__
    except ImportError as error:
        version = f"none ({error})"
    print(
        f"python {sys.version.split()[0]} torch {torch.__version__} cuda {torch.version.cuda} "
        f"triton {version} gcc {shutil.which('gcc')} Python.h {header.exists()}",
        flush=True,
    )


def _timed(
    model: Any, part: str, given: Any, compiler: str | None, options: Any, median: Any
) -> dict[str, Any]:
    """Compiles a part of a model and measures it; also how far it is from the uncompiled one."""
    from orbisim_world_model.graphs import Graphed

    function, arguments = _part(model, part, given)
    run = function if compiler is None else _compiled(function, compiler)
    with torch.no_grad():
        apart = 0.0
        if compiler is not None:
            pairs = zip(_tensors(run(*arguments)), _tensors(function(*arguments)), strict=True)
            apart = max(float((a - b).abs().max()) for a, b in pairs if a.numel())
        on_gpu = options.device.startswith("cuda")
        graph = Graphed(lambda: run(*arguments), lambda: None, on_gpu)
        brief = type(options)(**{**vars(options), "seconds": 0.2})
        return {"ms": round(median(graph, brief) * 1e3, 4), "apart": apart}


def _compiled(function: Callable[..., Any], compiler: str) -> Any:
    from orbisim_world_model.stepper import compiler_options

    torch._dynamo.reset()
    how: dict[str, Any] = {"backend": compiler}
    if compiler == "fused":
        how = {"options": compiler_options("fused")}
    return torch.compile(function, dynamic=False, fullgraph=True, **how)


def _part(model: Any, part: str, given: Any) -> tuple[Callable[..., Any], Any]:
    """A function and its arguments."""
    from orbisim_world_model.stepper import flat_step, plain_step

    x, memory, control, context = given
    if part == "features":
        return model.inputs, (x, control, context)
    if part == "network":
        with torch.no_grad():
            seen = model._cast(model.inputs(x, control, context))
        return model.network, (seen, memory)
    if part == "nested step":
        return plain_step(model), given
    return flat_step(model), (*x, memory, control, *context)


def _tensors(values: Any) -> list[torch.Tensor]:
    """Those of nested tuples, in order."""
    if isinstance(values, torch.Tensor):
        return [values]
    return [t for v in values if v is not None for t in _tensors(v)]


@contextmanager
def _within(seconds: int) -> Iterator[None]:
    """Raises TimeoutError when the time is over."""

    def stop(number: int, frame: Any) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
