"""Speed of the learned step, as ratios within one run.

    python tools/bench_learned.py --checkpoint zoo/push [--device cuda] [--json FILE]
        [--only variants,batch,gradient,cpu,phases,memory]

- variants: what each speed-up brings (weights combined, half precision, compiled in three ways),
  at one world (ms) and at 8,192 (control steps/s); the fastest at 8,192 is used by `batch`.
- batch: control steps/s at 1, 256, 4,096, 8,192, 65,536 worlds, and the share of the peak of
  matrix products in half precision.
- latency: one world, one control step, by the shipped settings.
- gradient: policy-gradient training steps/s (a two-layer policy, a window of 32 control steps).
- cpu: one world on one core, against C MuJoCo's control step of the same scene (needs MuJoCo).
- phases: the same at every step of an episode of the task's script, by what touches what.
- memory: of a training step against the number of objects, 2 to 8 (GPU); --plot draws it.
- compile-check: what torch's compiler says to the step and its parts (see compile_check.py).

Without --checkpoint, weights are random: speed does not depend on them.
"""

from __future__ import annotations

import argparse
import functools
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

BATCHES = (1, 256, 4096, 8192, 65536)
PEAK = 989e12
"""Dense half-precision products of an H100 or H200 by its datasheet, FLOP/s."""
PAPER = 29.41
"""Training steps/s of the paper's policy optimisation."""


def main() -> int:
    """Runs the chosen benchmarks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--scene", help="of `cpu`; the first of the checkpoint's tasks without one")
    parser.add_argument("--data", type=Path, help="episodes or a pack: the layout without one")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--only", default="variants,batch,latency,gradient,cpu,memory")
    parser.add_argument("--variants", default=USUAL, help="in this order")
    parser.add_argument(
        "--patience", type=float, default=300.0, help="seconds for the variants, or the check"
    )
    parser.add_argument("--gradient-worlds", default="1,16,256,1024")
    parser.add_argument("--gradient-compiler", default="joined", choices=("fused", "joined"))
    parser.add_argument("--use", choices=VARIANTS, help="variant for `batch`; the fastest if known")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each measurement")
    parser.add_argument("--largest", type=int, default=BATCHES[-1], help="number of worlds")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plot", type=Path, help="PNG of `memory`")
    options = parser.parse_args()
    model = _model(options)
    found: dict[str, Any] = {
        "device": _device_name(options.device),
        "parameters": sum(p.numel() for p in model.parameters()),
        "tokens": model.layout.tokens,
        "control_timestep": model.layout.timestep,
    }
    for name in options.only.split(","):
        found[name] = BENCHMARKS[name](model, options)
        print(name, json.dumps(found[name]), flush=True)
        if options.json:
            options.json.write_text(json.dumps(found, indent=1))
    return 0


def _model(options: Any) -> Any:
    from orbisim_world_model.checkpoint import load_checkpoint
    from orbisim_world_model.pack import Pack
    from orbisim_world_model.presets import preset
    from orbisim_world_model.trainer import new_model

    if options.checkpoint:
        return load_checkpoint(options.checkpoint).model
    if options.data and options.data.suffix == ".pack":
        return new_model(Pack.load(options.data), preset("default"), 0).eval()
    from orbisim_world_model.packing import read_data

    return new_model(read_data([options.data]), preset("default"), 0).eval()


def variants(model: Any, options: Any) -> dict[str, dict[str, Any]]:
    """Milliseconds at one world and control steps/s at 8,192, by variant."""
    from orbisim_world_model.stepper import Stepper

    found: dict[str, dict[str, Any]] = {}
    began, exact = time.perf_counter(), None
    for name in options.variants.split(","):
        if time.perf_counter() - began > options.patience:
            break
        stepper = Stepper(model, torch.device(options.device), VARIANTS[name])
        row: dict[str, Any] = {}
        for worlds in (1, min(8192, options.largest)):
            start = time.perf_counter()
            inputs = _inputs(stepper, worlds)
            state, _ = stepper(*inputs)
            prepared = time.perf_counter() - start
            seconds = _median(functools.partial(_replay, stepper, *inputs), options)
            if worlds == 1:
                exact = state if exact is None else exact
                row["apart"] = max(float((a - b).abs().max()) for a, b in _filled(state, exact))
            row[str(worlds)] = {
                "ms": seconds * 1e3,
                "control_steps_per_s": worlds / seconds,
                "prepared_s": prepared,
                "compiled": stepper.on_gpu and stepper.prepared(*inputs).compiled,
            }
        found[name] = row
        print("variant", name, json.dumps(row), flush=True)
    options.use = options.use or _fastest(found)
    return found


def check(model: Any, options: Any) -> dict[str, Any]:
    """Whether torch compiles the step and its parts."""
    from compile_check import compile_check

    return compile_check(model, options, _inputs, _median)


def _filled(one: Any, other: Any) -> list[tuple[Any, Any]]:
    return [(a, b) for a, b in zip(one, other, strict=True) if a.numel()]


def _fastest(found: dict[str, dict[str, Any]]) -> str:
    """The variant with the most control steps/s at the largest number of worlds."""

    def rate(name: str) -> float:
        return max(v["control_steps_per_s"] for v in found[name].values() if isinstance(v, dict))

    return max(found, key=rate)


def batch(model: Any, options: Any) -> list[dict[str, float]]:
    """Control steps/s by number of worlds."""
    from orbisim_world_model.stepper import Stepper

    rows = []
    stepper = Stepper(model, torch.device(options.device), VARIANTS[options.use or "shipped"])
    for worlds in (n for n in BATCHES if n <= options.largest):
        replay = functools.partial(_replay, stepper, *_inputs(stepper, worlds))
        seconds = _median(replay, options)
        rate = worlds / seconds
        flops = 2.0 * _weights_used(model) * rate
        rows.append({"worlds": worlds, "control_steps_per_s": rate, "of_peak": flops / PEAK})
        print("batch", options.use, json.dumps(rows[-1]), flush=True)
    return rows


def latency(model: Any, options: Any) -> dict[str, float]:
    """One world, states handed over and back on the device."""
    from orbisim_world_model.stepper import Stepper

    stepper = Stepper(model, torch.device(options.device))
    x, memory, control, context = _inputs(stepper, 1)
    whole = _median(lambda: stepper(x, memory, control, context), options)
    graph = _median(lambda: _replay(stepper, x, memory, control, context), options)
    return {"step_ms": whole * 1e3, "graph_ms": graph * 1e3}


def gradient(model: Any, options: Any) -> list[dict[str, float]]:
    """Updates/s of a policy by the gradient through 32 control steps, as the backend does them."""
    rows = []
    for worlds in map(int, options.gradient_worlds.split(",")):
        run = policy_update(model, worlds, options.device, options.gradient_compiler)
        seconds = _median(run, options)
        rows.append(update_row(worlds, seconds))
        print("gradient", json.dumps(rows[-1]), flush=True)
        if seconds > options.seconds:
            break
    return rows


WINDOW = 32
"""Control steps of an update."""


def policy_update(model: Any, worlds: int, device: str, compiler: Any) -> Callable[[], Any]:
    """An update of a policy of two hidden layers of 256, ready to be called."""
    from orbisim_world_model.policy_update import PolicyUpdate

    class Policy(torch.nn.Module):
        def __init__(self, width: int) -> None:
            super().__init__()
            linear, act = torch.nn.Linear, torch.nn.SiLU
            last = linear(256, max(model.controls, 1))
            self.layers = torch.nn.Sequential(
                linear(width, 256), act(), linear(256, 256), act(), last
            )

        def forward(self, x: Any) -> Any:
            seen = torch.cat([x.q, x.v, x.pos.flatten(1), x.quat.flatten(1)], dim=1)
            return torch.tanh(self.layers(seen))[:, : model.controls]

    def loss(x: Any) -> Any:
        return (x.pos if x.pos.numel() else x.q).square().flatten(1).sum(1)

    x, _, _, context = inputs_of(model, worlds, torch.device(device))
    width = x.q.shape[1] + x.v.shape[1] + 7 * x.pos.shape[1]
    update = PolicyUpdate(
        model,
        Policy(width),
        loss,
        context,
        torch.device(device),
        window=WINDOW,
        compiler=compiler if device.startswith("cuda") else None,
    )
    return functools.partial(update, x)


def update_row(worlds: int, seconds: float) -> dict[str, float]:
    """What there is to say of an update that takes so long."""
    rate = 1.0 / seconds
    row = {"worlds": worlds, "window": WINDOW, "updates_per_s": rate}
    more = {"sequences_per_s": rate * worlds, "control_steps_per_s": rate * worlds * WINDOW}
    times = {"times_the_paper": rate / PAPER, "in_control_steps": rate * WINDOW / PAPER}
    return {**row, **more, **times}


def cpu(model: Any, options: Any) -> dict[str, float]:
    """One world on one core: the learned control step against C MuJoCo's, alternating."""
    if not options.checkpoint:
        return {}
    learned, classical, nstep, episode = _side_by_side(options)
    # not without controls: servos that are told zero leave the training data, which takes a look
    controls = episode.controls(episode.horizon, learned.timestep, 0).swapaxes(0, 1)
    mid = episode.initial
    for control in controls[:10]:
        mid = learned.step(mid, control)
    return _timed(learned, classical, nstep, (mid, mid), controls[10], 60)


def phases(model: Any, options: Any) -> dict[str, dict[str, float]]:
    """As `cpu`, at every step of an episode: medians by what touches, and the worst step."""
    if not options.checkpoint:
        return {}
    learned, classical, nstep, episode = _side_by_side(options)
    controls = episode.controls(episode.horizon, learned.timestep, 0).swapaxes(0, 1)
    ours = learned.step(episode.initial, controls[0])  # it remembers from now on
    theirs = classical.step(episode.initial, controls[0], nstep)
    found: dict[str, list[dict[str, float]]] = {}
    for control in controls[1:]:
        row = _timed(learned, classical, nstep, (ours, theirs), control, 7)
        for name in ("all", _touching(episode.scene.model, theirs)):
            found.setdefault(name, []).append(row)
        ours = learned.step(ours, control)
        theirs = classical.step(theirs, control, nstep)
    return {
        name: {
            "steps": len(rows),
            **{key: statistics.median(row[key] for row in rows) for key in rows[0]},
            "worst_ratio": max(row["ratio"] for row in rows),
        }
        for name, rows in found.items()
    }


def _side_by_side(options: Any) -> Any:
    """Both backends on one core, how many of C MuJoCo's steps are one, and an episode."""
    import warnings

    from orbisim import make_backend
    from orbisim.episodes import episodes

    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    manifest = json.loads((options.checkpoint / "manifest.json").read_text())
    episode = episodes(options.scene or manifest["data"]["sources"][0]["task"], 1, 0)
    learned = make_backend(f"learned:{options.checkpoint}", episode.scene, device="cpu")
    classical = make_backend("mujoco", episode.scene, nthread=1)
    return learned, classical, round(learned.timestep / classical.timestep), episode


def _timed(
    learned: Any, classical: Any, nstep: int, states: Any, control: Any, repeats: int
) -> dict[str, float]:
    """Medians of a control step of each, in turn: of processor time, which others do not take."""
    pairs, now = [], time.process_time
    for _ in range(repeats):
        begun = now()
        learned.step(states[0], control)
        between = now()
        classical.step(states[1], control, nstep)
        pairs.append((between - begun, now() - between))
    ours, theirs = (statistics.median(values) for values in zip(*pairs, strict=True))
    return {"learned_ms": ours * 1e3, "mujoco_ms": theirs * 1e3, "ratio": ours / theirs}


def _touching(model: Any, state: Any) -> str:
    """What of an episode's step this is: objects touch each other, the robot one, or neither."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = state.qpos[0]
    mujoco.mj_fwdPosition(model, data)
    free = {int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == 0}
    pairs = [
        {model.geom_bodyid[geom] in free for geom in contact.geom}
        if all(model.body_weldid[model.geom_bodyid[geom]] for geom in contact.geom)
        else set()
        for contact in data.contact
    ]
    if {True} in pairs:
        return "object and object"
    return "robot and object" if {True, False} in pairs else "neither"


def memory(model: Any, options: Any) -> list[dict[str, float]]:
    """Peak memory of a training step by number of objects, MB."""
    import dataclasses

    from orbisim_world_model.dynamics import Dynamics, example

    if not options.device.startswith("cuda") or not model.layout.objects:
        return []
    rows = []
    for objects in range(2, 9):
        names = tuple(f"object{i}" for i in range(objects))
        layout = dataclasses.replace(model.layout, objects=names)
        larger = Dynamics(layout, model.config).build(model.controls)
        larger.load_state_dict(model.state_dict())
        larger.to(options.device).train()
        x, context = example(layout, 512)
        x, context = x.to(options.device), type(context)(*(c.to(options.device) for c in context))
        control = torch.zeros(512, model.controls, device=options.device)
        torch.cuda.reset_peak_memory_stats()
        state, h = x, larger.initial_memory(512)
        for _ in range(8):
            step = larger(state, h, control, context)
            state, h = step.state, step.memory
        state.pos.sum().backward()
        rows.append({"objects": objects, "peak_mb": torch.cuda.max_memory_allocated() / 1e6})
        print("memory", json.dumps(rows[-1]), flush=True)
        del larger, state, h, step
        torch.cuda.empty_cache()
    if options.plot:
        draw_memory(rows, options.plot)
    return rows


def draw_memory(rows: list[dict[str, float]], path: Path) -> None:
    """Memory against the number of objects, with a straight line through the points."""
    import matplotlib
    import numpy as np

    matplotlib.use("Agg")
    from matplotlib import pyplot

    x, y = ([row[name] for row in rows] for name in ("objects", "peak_mb"))
    slope, start = np.polyfit(x, y, 1)
    figure, axes = pyplot.subplots(figsize=(5, 3.5), layout="constrained")
    axes.plot(x, y, "o", label="training step, 512 sequences of 8 control steps")
    axes.plot(x, start + slope * np.array(x), "-", label=f"{slope:.0f} MB an object")
    axes.set(xlabel="objects", ylabel="peak memory, MB", ylim=(0, None))
    axes.legend()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


from orbisim_world_model.stepper import Speedups  # noqa: E402  (needs the path above)

VARIANTS = {
    "eager": Speedups(folded=False, kernels=False, compiled=None),
    "folded": Speedups(folded=True, kernels=False, compiled=None),
    "shipped": Speedups(),
    "kernels": Speedups(compiled="fused"),
    "fused": Speedups(kernels=False, compiled="fused"),
    "joined": Speedups(kernels=False, compiled="joined"),
    "fused_bf16": Speedups(kernels=False, compiled="fused", precision="bf16"),
    "fused_unfolded": Speedups(kernels=False, compiled="fused", folded=False),
    "inlined": Speedups(kernels=False, compiled="inlined"),
    "tuned": Speedups(kernels=False, compiled="tuned"),
}
USUAL = "eager,folded,fused,kernels,inlined,tuned,fused_bf16"
BENCHMARKS: dict[str, Callable[[Any, Any], Any]] = {
    "variants": variants,
    "batch": batch,
    "latency": latency,
    "gradient": gradient,
    "cpu": cpu,
    "phases": phases,
    "memory": memory,
    "compile-check": check,
}


def _inputs(stepper: Any, worlds: int, shared: bool = False) -> Any:
    x, _, control, context = inputs_of(stepper.model, worlds, stepper.device, shared)
    described = stepper.described(context)
    return stepper.completed(x), stepper.initial_memory(worlds), control, described


def inputs_of(model: Any, worlds: int, device: torch.device, shared: bool = False) -> Any:
    """Random states about the middle of the scene, controls and descriptors.

    Zeros would flatter: products of zeros are faster on a GPU. With `shared` all worlds have the
    same descriptors, as those of one scene have.
    """
    from orbisim_world_model.dynamics import example
    from orbisim_world_model.rotation import normalized

    random = torch.Generator().manual_seed(worlds)

    def noise(like: torch.Tensor, size: float) -> torch.Tensor:
        return size * torch.randn(like.shape, generator=random)

    x, context = example(model.layout, worlds)
    x = x._replace(
        q=noise(x.q, 0.5),
        v=noise(x.v, 0.2),
        pos=noise(x.pos, 0.1) + torch.tensor([0.5, 0.0, 0.1]),
        quat=normalized(noise(x.quat, 1.0)),
        vel=noise(x.vel, 0.1),
        ang=noise(x.ang, 0.5),
    )
    fields = []
    for like, scale in (
        (context.attributes, model.see_attributes),
        (context.world, model.see_world),
    ):
        mean, std = scale.mean.cpu(), scale.std.cpu()
        fields.append(mean + noise(like, 0.5) * torch.where(mean.abs() > 0, std, 0.0))
    fields = [field.to(device) for field in fields]
    if shared:
        fields = [field[:1].expand_as(field) for field in fields]
    control = noise(torch.zeros(worlds, model.controls), 0.5).to(device)
    context = context._replace(attributes=fields[0], world=fields[1], mask=None)
    if context.parts is not None:
        context = context._replace(parts=context.parts.to(device), part_mask=None)
    return x.to(device), None, control, context


def _replay(stepper: Any, x: Any, memory: Any, control: Any, context: Any) -> None:
    """The step alone, without copies in and out, where there is a graph."""
    if not stepper.on_gpu:
        stepper(x, memory, control, context)
        return
    stepper.prepared(x, memory, control, context).run()


def _weights_used(model: Any) -> float:
    """Multiplications a world and step: each weight of a token's layers once a token."""
    matrices = [p.numel() for p in model.network.parameters() if p.dim() > 1]
    return float(sum(matrices) * model.layout.tokens)


def _median(function: Callable[[], Any], options: Any) -> float:
    """Median seconds of a call; GPU work is waited for over several calls at once."""
    gpu = options.device.startswith("cuda")
    function()
    function()
    times: list[float] = []
    began = time.perf_counter()
    while time.perf_counter() - began < options.seconds or len(times) < 3:
        repeats = 20 if gpu else 1
        if gpu:
            torch.cuda.synchronize()
        start = time.perf_counter()
        for _ in range(repeats):
            function()
        if gpu:
            torch.cuda.synchronize()
        times.append((time.perf_counter() - start) / repeats)
    return statistics.median(times)


def _device_name(device: str) -> str:
    return torch.cuda.get_device_name(device) if device.startswith("cuda") else "cpu"


if __name__ == "__main__":
    sys.exit(main())
