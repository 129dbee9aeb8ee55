"""Control steps/s of `learned`, `warp` and C MuJoCo on one scene against the number of worlds.

    python tools/bench_crossover.py --checkpoint backends/orbisim_world_model/zoo/push
        [--only mujoco,learned,warp] [--json FILE] [--plot FILE]

All in one run. Classical backends go on from states in the middle of the task's scripted episodes,
with the episodes' controls, and nothing but the last state is read back; `learned` replays the CUDA
graph of its step (its time does not depend on the state). A control step is the checkpoint's; a
classical backend takes as many timesteps as the scene has in it. `mujoco` runs on one thread and on
--threads of them. Needs MuJoCo, for `warp` MuJoCo-Warp and a GPU (on the CPU: a rehearsal).
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import bench_learned  # noqa: E402  (needs the path above)
import from_source  # noqa: E402

EPISODES, STARTS = 16, 16
"""Scripted episodes, and states of each that worlds start from."""
GOAL = 20.0
"""Times `warp` at its best number of worlds."""


def main() -> int:
    """Measures, writes and draws."""
    options = _parser().parse_args()
    warnings.simplefilter("ignore")
    from_source.register()
    found: dict[str, Any] = {"device": bench_learned._device_name(options.device), "rows": []}
    if options.after:
        found["rows"] += json.loads(options.after.read_text())["rows"]
    for name in options.only.split(","):
        for row in RUNS[name](options):
            print(json.dumps(row), flush=True)
            found["rows"].append(row)
            found["summary"] = summary(found["rows"])
            if options.json:
                options.json.write_text(json.dumps(found, indent=1))
    print(json.dumps(found["summary"], indent=1))
    if options.plot:
        draw(found["rows"], options.plot)
    return 0


def learned(options: Any) -> Any:
    """Rows of the learned step."""
    from orbisim_world_model.checkpoint import load_checkpoint
    from orbisim_world_model.stepper import Stepper

    model = load_checkpoint(options.checkpoint).model
    speedups = bench_learned.VARIANTS[options.use]
    stepper = Stepper(model, torch.device(options.device), speedups)
    timing = SimpleNamespace(device=options.device, seconds=options.seconds)
    for worlds in _numbers(options.learned_worlds):
        inputs = bench_learned._inputs(stepper, worlds)
        replay = functools.partial(bench_learned._replay, stepper, *inputs)
        yield _row("learned", worlds, 1, bench_learned._median(replay, timing))


def mujoco(options: Any) -> Any:
    """Rows of C MuJoCo: one thread, then several."""
    for threads, worlds in ((1, 16), (options.threads, 64 * options.threads)):
        yield _classical(options, "mujoco", worlds, f"mujoco, {threads} threads", nthread=threads)


def warp(options: Any) -> Any:
    """Rows of MuJoCo-Warp."""
    arrays = "torch" if options.device.startswith("cuda") else "numpy"
    for worlds in _numbers(options.warp_worlds):
        yield _classical(options, "warp", worlds, "warp", device=options.device, arrays=arrays)


def _classical(options: Any, name: str, worlds: int, label: str, **how: Any) -> dict[str, Any]:
    from orbisim import make_backend
    from orbisim.state import State

    scene, qpos, qvel, controls, held = _starts(_task(options.checkpoint), options.steps)
    backend = make_backend(name, scene, nworld=worlds, **how)
    nstep = round(held / backend.timestep)
    index = np.arange(worlds) % len(qpos)
    steps = max(2, min(controls.shape[1], options.most // worlds))
    state = State(np.zeros(worlds), qpos[index], qvel[index], np.zeros((worlds, 0)))
    sequence: Any = controls[index, :steps]
    if how.get("arrays") == "torch":
        sequence = torch.as_tensor(sequence, device=options.device, dtype=torch.float32)
    times = []
    for _ in range(1 + options.repeats):  # the first prepares
        start = time.perf_counter()
        final = backend.rollout(state, sequence, nstep=nstep, sensors=False).final
        float(final.qpos[0, 0])
        if options.device.startswith("cuda"):
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    row = _row(label, worlds, steps, min(times[1:]))
    return {**row, "first_s": times[0], "timesteps": nstep}


@functools.lru_cache(maxsize=1)
def _starts(task: str, steps: int) -> tuple[Any, Any, Any, Any, float]:
    """The scene, states [W, nq], [W, nv] within scripted episodes, what follows [W, steps, nu]."""
    from orbisim import make_backend, tasks

    trials = tasks.make(task).trials(EPISODES, seed=0)
    backend = make_backend("mujoco", trials.scene)
    nstep = round(trials.held / backend.timestep)
    whole = trials.sequence.shape[1]
    path = backend.rollout(trials.initial, trials.sequence, nstep=nstep, sensors=False)
    firsts = np.linspace(0, whole - steps - 1, STARTS).astype(int)
    pairs = [(episode, first) for first in firsts for episode in range(EPISODES)]
    qpos, qvel = (np.array([a[e, f] for e, f in pairs]) for a in (path.qpos, path.qvel))
    controls = np.array([trials.sequence[e, f + 1 : f + 1 + steps] for e, f in pairs])
    return trials.scene, qpos, qvel, controls, trials.held


def _task(checkpoint: Path) -> str:
    manifest = json.loads((checkpoint / "manifest.json").read_text())
    return str(manifest["data"]["sources"][0]["task"]).removeprefix("task:")


def _row(backend: str, worlds: int, steps: int, seconds: float) -> dict[str, Any]:
    rate = worlds * steps / seconds
    return {"backend": backend, "worlds": worlds, "steps": steps, "control_steps_per_s": rate}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The best of each backend, and how `learned` compares."""
    best: dict[str, dict[str, Any]] = {}
    for row in rows:
        if row["control_steps_per_s"] > best.get(row["backend"], row)["control_steps_per_s"]:
            best[row["backend"]] = row
        best.setdefault(row["backend"], row)
    found: dict[str, Any] = {name: row["control_steps_per_s"] for name, row in best.items()}
    if "learned" in found:
        ratios = {f"learned over {n}": found["learned"] / found[n] for n in best if n != "learned"}
        found |= ratios
        if "warp" in best:
            found |= {"goal": GOAL, "reached": ratios["learned over warp"] >= GOAL}
    return found


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Control steps/s against worlds; C MuJoCo, which steps them one after another, as lines."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for name in dict.fromkeys(row["backend"] for row in rows):
        chosen = [row for row in rows if row["backend"] == name]
        x, y = ([row[key] for row in chosen] for key in ("worlds", "control_steps_per_s"))
        if name.startswith("mujoco"):
            axes.axhline(y[0], linestyle="--", color="0.4" if "1 " in name else "0.7", label=name)
        else:
            axes.plot(x, y, "o-", label=name)
    axes.set(xscale="log", yscale="log", xlabel="worlds", ylabel="control steps/s")
    axes.grid(which="major", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


RUNS = {"mujoco": mujoco, "learned": learned, "warp": warp}


def _numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",") if part]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--only", default="mujoco,learned,warp")
    parser.add_argument("--use", choices=bench_learned.VARIANTS, default="fused")
    parser.add_argument("--learned-worlds", default="1,256,4096,65536")
    parser.add_argument("--warp-worlds", default="1,256,1024,4096,16384,65536")
    parser.add_argument("--threads", type=int, default=16)
    parser.add_argument("--steps", type=int, default=20, help="control steps of a classical run")
    parser.add_argument("--most", type=int, default=200_000, help="worlds times control steps")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=2.0, help="of each learned measurement")
    parser.add_argument("--after", type=Path, help="--json of what ran just before, to go with it")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plot", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())
