"""What the learned step's time on a GPU is made of: kernels by name, tiles, environments.

    python tools/profile_learned.py OUT [--jobs tiles step environment rollout gradient]
        [--checkpoint CHECKPOINT]

Each measurement is a process of its own. All compile at the same time; when all are ready, or
after `--patience`, one after the other measures: milliseconds by CUDA events, and the kernels of
one call by torch's profiler; how many others were still compiling then stands beside.
OUT/profile.json has what is finished, early and often; what fails has its error.

- tiles: `network.fused` alone, in several ways to cut it, by number of worlds, and its relative
  error against the same network in float32.
- step: the whole step, with and without these kernels (`kernels/torch_variances`: without that of
  the variances).
- environment: `DeviceEnvironment` of push, with a policy.
- gradient: an update of a policy through 32 control steps.
- rollout: `backend.rollout` of 20 control steps, with everything that is watched.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import statistics
import subprocess
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

PUSH = ROOT / "backends/orbisim_world_model/zoo/push"
FEW, MANY, LARGE = "16,128,128,128,8,3", "64,64,64,2048,4,3", "128,64,64,2048,8,3"
"""Of `network.fused.Tile`."""
SIZES = (1, 4096, 65536)
JOBS = {
    "step": [
        *(f"step:kernels{more}:65536" for more in ("/shared", "", "/fused/shared")),
        *(f"step:kernels{more}:1" for more in ("", "/fused")),
        "step:kernels/shared:8192",
        "step:kernels/shared:4096",
        "step:compiled:65536",
        "step:compiled:1",
    ],
    "tiles": [f"tile:{tile}" for tile in (MANY, LARGE, FEW)],
    "environment": [f"environment:{n}" for n in (65536, 16384, 4096)],
    "rollout": ["rollout:65536"],
    "gradient": [f"gradient:{kind}:{n}" for n in (1, 1024) for kind in ("fused", "joined")],
}

Measure = Callable[[], dict[str, Any]]


def main() -> int:
    """Runs the jobs, or one of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--jobs", nargs="*", default=list(JOBS))
    parser.add_argument("--job", help="one, by its own name; used by this tool itself")
    parser.add_argument("--patience", type=float, default=75.0, help="s that all may compile")
    parser.add_argument("--limit", type=float, default=150.0, help="s that one may compile")
    parser.add_argument("--largest", type=int, default=SIZES[-1], help="number of worlds")
    parser.add_argument("--checkpoint", type=Path, default=PUSH, help="`tiles`, `step`, `gradient`")
    options = parser.parse_args()
    if options.job:
        return job(options)
    options.out.mkdir(parents=True, exist_ok=True)
    names = [n for part in options.jobs for n in JOBS.get(part, [part])]
    words = [sys.executable, __file__, str(options.out), "--largest", str(options.largest)]
    words += ["--checkpoint", str(options.checkpoint)]
    environment = {**os.environ, "TORCHINDUCTOR_COMPILE_THREADS": "2", "OMP_NUM_THREADS": "1"}
    running = {
        name: subprocess.Popen(
            [*words, "--job", name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
        )
        for name in names
    }
    began = time.monotonic()
    ready = {name: threading.Event() for name in names}
    for name, process in running.items():
        threading.Thread(target=_await, args=(process, ready[name]), daemon=True).start()
    for event in ready.values():  # measured undisturbed, if it does not take too long
        event.wait(max(0.0, options.patience - (time.monotonic() - began)))
    found: dict[str, Any] = {}
    for name in sorted(names, key=lambda n: not ready[n].is_set()):  # in order, the ready first
        process = running[name]
        still = sum(not event.is_set() for event in ready.values())
        try:
            if not ready[name].wait(max(0.0, options.limit - (time.monotonic() - began))):
                raise TimeoutError(f"not compiled within {options.limit:g} s")
            answer, _ = process.communicate("go\n", timeout=60)
            found[name] = json.loads(answer.strip().splitlines()[-1])
        except Exception as error:  # one that failed must not lose the others
            process.kill()
            found[name] = {"failed": repr(error)[:300]}
        found[name]["others_still_compiling"] = still
        (options.out / "profile.json").write_text(json.dumps(found, indent=1))
        said = {k: v for k, v in found[name].items() if k != "kernels"}
        print(name, json.dumps(said)[:400], flush=True)
    return 0


def _await(process: Any, ready: threading.Event) -> None:
    """Until a job says that it is ready, or has ended."""
    process.stdout.readline()
    ready.set()


def job(options: Any) -> int:
    """Compiles, says so, waits until it may measure, and prints what it found."""
    warnings.simplefilter("ignore")
    kind, _, rest = options.job.partition(":")
    began = time.perf_counter()
    try:
        import from_source

        from_source.register("mujoco", "learned")  # where nothing is installed, too
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            measure = PREPARE[kind](rest, options)
        prepared = time.perf_counter() - began
        print("ready", flush=True)
        sys.stdin.readline()
        found = measure()
        found["prepared_s"] = prepared
        found["warnings"] = sorted({str(w.message)[:400] for w in said})[:5]
    except Exception as error:
        print("ready", flush=True)
        found = {"failed": repr(error)[:400], "where": traceback.format_exc()[-800:]}
    if torch.cuda.is_available():
        found["device"] = torch.cuda.get_device_name()
    print(json.dumps(found), flush=True)
    return 0


def tile(rest: str, options: Any) -> Measure:
    """`network.fused` with one tile."""
    from orbisim_world_model.graphs import Graphed
    from orbisim_world_model.network.fused import FusedNetwork, Tile

    model, device = _model(options), _device()
    torch.backends.cuda.matmul.allow_tf32 = False
    exact = model.network.to(device).requires_grad_(False)
    fused = FusedNetwork(model.network, Tile(*map(int, rest.split(","))))
    fused = fused.to(device, torch.float16).requires_grad_(False)
    runs, errors = {}, {}
    for worlds in (n for n in SIZES if n <= options.largest):
        if worlds * fused.count > 1 << 20:
            continue
        inputs = _random_inputs(model.sizes, worlds, device)
        half = inputs._replace(
            **{n: v.half() for n, v in inputs._asdict().items() if isinstance(v, torch.Tensor)}
        )
        memory = fused.initial_memory(worlds)
        run = functools.partial(fused, half, memory)
        found = run()
        if worlds <= 4096:
            wanted = exact(inputs, exact.initial_memory(worlds))
            for name in ("robot", "objects"):
                a, b = getattr(wanted, name).double(), getattr(found, name).double()
                errors[f"{name} {worlds}"] = float((a - b).norm() / a.norm())
        runs[worlds] = Graphed(run, lambda: None, device.type == "cuda")

    def measure() -> dict[str, Any]:
        times = {worlds: _milliseconds(run) for worlds, run in runs.items()}
        return {"ms": times, "error": errors, "kernels": _kernels(runs[max(runs)])}

    return measure


def step(rest: str, options: Any) -> Measure:
    """The whole step: `kernels` or `compiled`, and after slashes what is not as usual."""
    from bench_learned import _inputs
    from orbisim_world_model.network.fused import Tile
    from orbisim_world_model.stepper import Speedups, Stepper

    words, _, worlds = rest.partition(":")
    kind, *more = words.split("/")
    compiler: Any = "fused" if "fused" in more else "joined"
    model = _model(options)
    own = kind == "kernels"
    variances = own and "torch_variances" not in more
    speedups = Speedups(kernels=own, variances=variances, compiled=compiler)
    stepper = Stepper(model, _device(), speedups)
    tiles = [word for word in more if "," in word]
    if tiles and stepper._kernels is not None:
        stepper._kernels.network.tile = Tile(*map(int, tiles[0].split(",")))
    inputs = _inputs(stepper, int(worlds), "shared" in more)
    found, memory = stepper(*inputs)
    if not stepper.on_gpu:
        return lambda: {"ms": _milliseconds(functools.partial(stepper, *inputs))}
    slot = stepper.prepared(*inputs)
    few = slice(0, 256)
    exact = model.to(stepper.device)
    x, context = type(found)(*(f[few] for f in inputs[0])), inputs[3]
    context = context._replace(attributes=context.attributes[few], world=context.world[few])
    with torch.no_grad():
        wanted = exact(x, inputs[1][few].float(), inputs[2][few], context)
    apart = {
        name: float((a[few] - b).abs().max())
        for name, a, b in zip(found._fields, found, wanted.state, strict=True)
        if b.numel()
    }
    rows = ((memory[few] - wanted.memory).abs() / wanted.memory.abs().clamp_min(1e-6)).flatten()
    apart["variance, relative, 90 %"] = float(rows.float().quantile(0.9)) if len(rows) else 0.0

    def measure() -> dict[str, Any]:
        ms = _milliseconds(slot.run)
        whole = _milliseconds(functools.partial(stepper, *inputs))
        rate = int(worlds) / ms * 1e3
        found = {"ms": ms, "with_copies_ms": whole, "control_steps_per_s": rate, "apart": apart}
        found["kernels_used"] = stepper._kernels is not None
        return {**found, "compiled": slot.compiled, "kernels": _kernels(slot.run)}

    return measure


def environment(rest: str, options: Any) -> Measure:
    """Push with rewards: random actions, and a policy."""
    from bench_policies import runs

    worlds = int(rest)
    random, policy = runs("push", worlds, str(_device()), 100)
    random()
    policy()

    def measure() -> dict[str, Any]:
        ms, both = _milliseconds(random), _milliseconds(policy)
        found = {"ms": ms, "environment_steps_per_s": worlds / ms * 1e3}
        found["with_policy_per_s"] = worlds / both * 1e3
        return {**found, "kernels": _kernels(random)}

    return measure


def rollout(rest: str, options: Any) -> Measure:
    """The backend as users have it, with tensors on the device."""
    from orbisim import State, make_backend
    from orbisim.tasks.push import Push

    worlds, steps, device = int(rest), 20, _device()
    backend = make_backend("learned", Push().scene(), nworld=worlds, device=str(device))
    first = backend.reset(worlds)
    fields = (first.time, first.qpos, first.qvel, first.act)
    state = State(*(torch.as_tensor(f, dtype=torch.float32).to(device) for f in fields))
    controls = state.qpos[:, None, :7].repeat(1, steps, 1)
    controls[..., 6] = 0.0
    run = functools.partial(backend.rollout, state, controls)
    run()

    def measure() -> dict[str, Any]:
        ms = _milliseconds(run)
        rate = worlds * steps / ms * 1e3
        return {"ms": ms, "control_steps_per_s": rate, "kernels": _kernels(run)}

    return measure


def gradient(rest: str, options: Any) -> Measure:
    """An update of a policy (see `bench_learned.policy_update`)."""
    from bench_learned import policy_update, update_row

    compiler, _, worlds = rest.partition(":")
    run = policy_update(_model(options), int(worlds), str(_device()), compiler)
    run()

    def measure() -> dict[str, Any]:
        ms = _milliseconds(run)
        return {"ms": ms, **update_row(int(worlds), ms / 1e3), "kernels": _kernels(run)}

    return measure


PREPARE: dict[str, Callable[[str, Any], Measure]] = {
    "tile": tile,
    "step": step,
    "environment": environment,
    "rollout": rollout,
    "gradient": gradient,
}


def _model(options: Any) -> Any:
    from orbisim_world_model.checkpoint import load_checkpoint

    return load_checkpoint(options.checkpoint).model.eval()


def _device() -> torch.device:
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def _random_inputs(sizes: Any, worlds: int, device: torch.device) -> Any:
    from orbisim_world_model.network.inputs import Inputs

    torch.manual_seed(worlds)
    many, tokens = sizes.many, sizes.tokens
    shapes = (
        (sizes.robot,),
        (many, sizes.objects),
        (tokens, tokens, sizes.edges),
        (many, sizes.attributes),
        (sizes.world,),
        (sizes.control,),
    )
    return Inputs(*(torch.randn(worlds, *shape, device=device) for shape in shapes), None)


def _milliseconds(run: Callable[[], Any]) -> float:
    """Median of a call."""
    if not torch.cuda.is_available():
        began = time.perf_counter()
        run()
        return (time.perf_counter() - began) * 1e3
    for _ in range(3):
        run()
    times = []
    for _ in range(15):
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        for _ in range(5):
            run()
        end.record()
        torch.cuda.synchronize()
        times.append(begin.elapsed_time(end) / 5)
    return statistics.median(times)


def _kernels(run: Callable[[], Any], most: int = 40) -> list[Any]:
    """Name, number of launches and microseconds of the kernels of a call, the longest first."""
    if not torch.cuda.is_available():
        return []
    from torch.profiler import ProfilerActivity, profile

    run()
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CUDA]) as seen:
        run()
        torch.cuda.synchronize()
    rows = [(e.key[:90], e.count, round(e.device_time_total, 1)) for e in seen.key_averages()]
    rows = sorted((row for row in rows if row[2] > 0), key=lambda row: -row[2])
    total = ("all", sum(row[1] for row in rows), round(sum(row[2] for row in rows), 1))
    return [total, *rows[:most]]


if __name__ == "__main__":
    sys.exit(main())
