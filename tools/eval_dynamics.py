"""The measurements of learned dynamics that docs/benchmarks.md reports.

    python tools/eval_dynamics.py --zoo ZOO --data DATA [--only errors,friction,noise,ceiling,
        returns,ball] [--json FILE]

ZOO has a folder for each checkpoint (as tools/train_all.py names them), DATA what
tools/collect_all.py wrote (or packs of it). What is missing is left out.

- errors: open-loop errors of each checkpoint and of constant velocity on its held-out episodes,
  and of the push models on the sets out of distribution.
- friction: how far the second cube slides on tables of low and high friction, against MuJoCo.
  With --tails, the distances between both ends of a slide, too.
- noise: errors at 100 control steps from states with noise (1 cm, 2 deg; 3 cm, 7 deg).
- ceiling: C MuJoCo started from states rounded to float32, on the suite's held-out episodes, at 100
  and 1,000 of the suite's control steps (`errors` counts the model's own).
- returns: of the suite's feedback policies under `learned` and under `mujoco`.
- ball: gradient descent on the initial velocity through the model, judged by Newton's equations,
  and with --newton by the package itself, next to its own gradient descent.
"""

from __future__ import annotations

import argparse
import functools
import json
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import from_source  # noqa: E402  (needs the path above)

from orbisim.tasks.domains import SUBSTEPS, SUITE_DOMAINS  # noqa: E402

TESTS = {
    "push": "push_test",
    "cubes": "push_cubes_test",
    "ball": "ball_test",
    "toss": "toss_test",
}
OUTSIDE = ("push_ood_slippery", "push_ood_rough", "push_ood_three")
NOISE = {"none": (0.0, 0.0), "moderate": (0.01, 2.0), "strong": (0.03, 7.0)}


def main() -> int:
    """Runs the chosen measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--zoo", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--only", default=",".join(MEASUREMENTS))
    parser.add_argument("--checkpoints", default="", help="only these of the zoo")
    parser.add_argument("--newton", type=Path, help="Python with the package newton, for `ball`")
    parser.add_argument("--iterations", type=int, default=60, help="of gradient descent, `ball`")
    parser.add_argument("--seeds", type=int, default=100, help="episodes of each domain, `returns`")
    parser.add_argument("--workers", type=int, default=1, help="processes, `returns`")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--episodes", type=int, default=256)
    parser.add_argument("--tails", action="store_true", help="90 %% and worst beside medians")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    from_source.register("mujoco", "learned")
    found: dict[str, Any] = {}
    for name in options.only.split(","):
        found[name] = MEASUREMENTS[name](options)
        print(json.dumps({name: found[name]}, indent=1), flush=True)
        if options.json:
            options.json.write_text(json.dumps(found, indent=1))
    return 0


def errors(options: Any) -> dict[str, Any]:
    """Medians by checkpoint, data set and horizon."""
    table: dict[str, Any] = {}
    for name, checkpoint in _checkpoints(options).items():
        base = name.split("_")[0].split("-")[0]
        job = "point_mass" if name.startswith("point_mass") else base
        tests = [TESTS.get(job, f"suite_{job}_test")]
        tests += {"push": OUTSIDE, "cubes": ("pick_and_place_test",)}.get(job, ())
        for test in tests:
            pack = _pack(options, test, checkpoint)
            if pack is None or not _knows(checkpoint, pack):
                continue  # no such data, or a model for one number of objects alone
            long = job in SUITE_DOMAINS
            fine = SUBSTEPS.get(job, 1)
            ours = tuple(fine * n for n in (10, 50, 100, 1000))
            horizons = ours if long else (10, 20, 36) if job == "ball" else None
            table[f"{name} on {test}"] = _medians(checkpoint, pack, options, horizons, long)
    return table


def _figure(values: Any, options: Any) -> Any:
    """Median of a tensor; with --tails median, 90 % and worst."""
    values = torch.nan_to_num(values.flatten().double(), nan=torch.inf)
    row = [float(values.median()), float(values.quantile(0.9)), float(values.max())]
    return row if options.tails else row[0]


def _knows(checkpoint: Any, pack: Any) -> bool:
    """Whether a checkpoint can predict these episodes."""
    from orbisim.errors import InputError

    try:
        _for_objects(checkpoint, pack)
    except InputError:
        return False
    return True


def _medians(
    checkpoint: Any, pack: Any, options: Any, horizons: Any, whole: bool
) -> dict[str, Any]:
    from orbisim_world_model.evaluate import HORIZONS, constant_velocity, evaluate

    burn = 0 if whole or horizons else 8
    rows: dict[str, Any] = {}
    still = constant_velocity(pack, checkpoint.model.config)
    model = _for_objects(checkpoint, pack).to(pack.device)
    for label, candidate in (("model", model), ("constant_velocity", still)):
        result = evaluate(candidate, pack, horizons or HORIZONS, burn=burn, limit=options.episodes)
        rows[label] = {
            horizon: {
                k: [v["median"], v["p90"], v["worst"]] if options.tails else v["median"]
                for k, v in values.items()
                if isinstance(v, dict)
            }
            for horizon, values in result.items()
        }
    return rows


def friction(options: Any) -> dict[str, Any]:
    """Mean distance, mm, between where the second cube starts and where it ends."""
    table: dict[str, Any] = {}
    for name, checkpoint in _checkpoints(options, "push").items():
        ours, theirs, apart = {}, {}, {}
        for level in ("low", "high"):
            pack = _pack(options, f"push_{level}_friction", checkpoint)
            if pack is None:
                return table
            truth, predicted = _open_loop(checkpoint, pack, options, 0)
            start = pack.states(pack.start[: truth.pos.shape[1]]).pos[:, 1, :2]
            for result, states in ((ours, predicted), (theirs, truth)):
                result[level] = float((states.pos[-1, :, 1, :2] - start).norm(dim=-1).mean() * 1e3)
            ends = (predicted.pos - truth.pos)[-1, :, 1, :2].norm(dim=-1) * 1e3
            apart[level] = _figure(ends, options)
        expected = theirs["low"] - theirs["high"]
        table[name] = {
            "model_mm": ours,
            "mujoco_mm": theirs,
            "difference_off_by": (ours["low"] - ours["high"]) / expected - 1.0,
            "ends_apart_mm": apart,
        }
    return table


def noise(options: Any) -> dict[str, Any]:
    """Position error, mm, and rotation error, deg, of objects after 100 control steps."""
    from orbisim_world_model.rotation import conjugate, logarithm, multiply

    table: dict[str, Any] = {}
    for name, checkpoint in _checkpoints(options, "push").items():
        pack = _pack(options, "push_test", checkpoint)
        if pack is None:
            return table
        generator = torch.Generator().manual_seed(0)
        table[name] = {}
        for level, (distance, angle) in NOISE.items():
            disturb = functools.partial(_disturbed, distance, angle, generator)
            truth, predicted = _open_loop(checkpoint, pack, options, 8, disturb)
            end, there = predicted.at(-1), truth.at(-1)
            turn = logarithm(multiply(end.quat, conjugate(there.quat))).norm(dim=-1)
            table[name][level] = {
                "position_mm": _figure((end.pos - there.pos).norm(dim=-1) * 1e3, options),
                "rotation_deg": _figure(torch.rad2deg(turn), options),
            }
    return table


def _disturbed(distance: float, angle: float, generator: Any, x: Any) -> Any:
    """The state with noise on the objects' positions, m, and rotations, deg."""
    from orbisim_world_model.rotation import exponential, multiply

    shift = distance * torch.randn(x.pos.shape, generator=generator)
    turn = np.deg2rad(angle) * torch.randn(x.pos.shape, generator=generator)
    quat = multiply(exponential(turn.to(x.pos)), x.quat)
    return x._replace(pos=x.pos + shift.to(x.pos), quat=quat)


def ceiling(options: Any) -> dict[str, Any]:
    """Normalised error of C MuJoCo from float32-rounded states, as `evaluate` computes it."""
    from orbisim_world_model.evaluate import normalised

    from orbisim import load_scene, make_backend
    from orbisim.state import State

    table: dict[str, Any] = {}
    for domain, task in SUITE_DOMAINS.items():
        pack = _pack(options, f"suite_{domain}_test", None)
        if pack is None:
            continue
        scene = load_scene(f"suite:{domain}-{task}")
        backend = make_backend("mujoco", scene)
        nstep = round(pack.layout.timestep / backend.timestep)
        table[domain] = {}
        for control_steps in (100, 1000):
            horizon = SUBSTEPS.get(domain, 1) * control_steps
            chosen = torch.nonzero(pack.length >= horizon)[:, 0]
            if not len(chosen):
                continue
            rows = pack.start[chosen][:, None] + torch.arange(horizon + 1)
            qpos, qvel, act, ctrl = (
                t[rows].double().numpy() for t in (pack.qpos, pack.qvel, pack.act, pack.ctrl)
            )
            start = State(np.zeros(len(rows)), qpos[:, 0], qvel[:, 0], act[:, 0])
            exact = backend.rollout(start, ctrl[:, :-1], nstep=nstep)
            rng = np.random.default_rng(0)
            nudge = 6e-8 * rng.uniform(-1, 1, start.qpos.shape) * np.abs(start.qpos)
            rounded = start.replace(qpos=start.qpos + nudge)
            other = backend.rollout(rounded, ctrl[:, :-1], nstep=nstep)
            states = [_entities(pack.layout, run) for run in (other, exact)]
            table[domain][control_steps] = _figure(normalised(*states, pack), options)
    return table


def returns(options: Any) -> dict[str, Any]:
    """Of the domains that the zoo has, or all where it has the one model of them."""
    import suite_returns

    only = options.checkpoints.split(",") if options.checkpoints else ()
    chosen = suite_returns.chosen(options.zoo, only)
    return suite_returns.table(chosen, options.seeds, options.workers)


def ball(options: Any) -> dict[str, Any]:
    """Gradient descent with the paper's rate of 0.8 on the initial velocity."""
    import time

    from orbisim_world_model.dynamics import example
    from orbisim_world_model.pack import Pack

    checkpoint = _checkpoints(options, "ball").get("ball")
    pack: Pack | None = _pack(options, "ball_test", checkpoint)
    if checkpoint is None or pack is None:
        return {}
    from orbisim.tasks.ball_reference import loss, simulate

    model = checkpoint.model
    x, _ = example(model.layout)
    context = pack.context(torch.zeros(1, dtype=torch.long))._replace(mask=None)
    x = x._replace(pos=torch.tensor([[[0.0, -0.5, 1.0]]]))
    target = torch.tensor([0.0, -2.0, 1.5])
    velocity = torch.tensor([0.0, 5.0, -5.0], requires_grad=True)
    history, began = [], time.perf_counter()
    for _ in range(options.iterations):
        state, h = x._replace(vel=velocity.reshape(1, 1, 3)), model.initial_memory(1)
        for _ in range(36):
            step = model(state, h, torch.zeros(1, model.controls), context)
            state, h = step.state, step.memory
        inside = (state.pos[0, 0] - target).square().sum()
        (slope,) = torch.autograd.grad(inside, velocity)
        history.append((float(inside), velocity.detach().numpy().copy()))
        velocity = (velocity - 0.8 * slope).detach().requires_grad_(True)
    seconds = time.perf_counter() - began
    best, chosen = min(history, key=lambda entry: entry[0])
    outside = float(loss(simulate(chosen)[0][-1]))
    return {
        "newton": _newton(options, chosen),
        "inside": best,
        "outside": outside,
        "miss_mm": outside**0.5 * 1e3,
        "velocity": [float(v) for v in chosen],
        "seconds": seconds,
        "losses": [entry[0] for entry in history],
    }


def _newton(options: Any, velocity: Any) -> dict[str, Any]:
    """What Newton's own simulation says, and its own gradient descent; {} without the package."""
    if options.newton is None:
        return {}
    numbers = [str(float(v)) for v in velocity]
    script = str(ROOT / "tools" / "newton_ball.py")
    command = [str(options.newton), script, *numbers, "--iterations", str(options.iterations)]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    found: dict[str, Any] = json.loads(lines[-1])
    return found


MEASUREMENTS: dict[str, Callable[[Any], Any]] = {
    "errors": errors,
    "friction": friction,
    "noise": noise,
    "ceiling": ceiling,
    "returns": returns,
    "ball": ball,
}


def _checkpoints(options: Any, prefix: str = "") -> dict[str, Any]:
    from orbisim_world_model.checkpoint import load_checkpoint
    from orbisim_world_model.families import is_cloth

    every = sorted(path.parent for path in options.zoo.glob(f"{prefix}*/manifest.json"))
    folders = [folder for folder in every if not is_cloth(folder)]  # see `orbisim eval dynamics`
    wanted = options.checkpoints.split(",") if options.checkpoints else None
    chosen = [f for f in folders if wanted is None or f.name in wanted]
    return {folder.name: load_checkpoint(folder) for folder in chosen}


def _pack(options: Any, name: str, checkpoint: Any) -> Any:
    from orbisim_world_model.pack import Pack

    pack, raw = options.data / f"{name}.pack", options.data / f"{name}.h5"
    if pack.exists():
        return Pack.load(pack).to(options.device)
    if not raw.exists():
        return None
    from orbisim_world_model.packing import read_data

    return read_data([raw]).to(options.device)


def _for_objects(checkpoint: Any, pack: Any) -> Any:
    """The model for the pack's number of objects, where it can have another."""
    from orbisim_world_model.checkpoint import load_for

    return load_for(checkpoint.path, pack.layout).model


def _open_loop(
    checkpoint: Any, pack: Any, options: Any, burn: int, disturb: Any = None
) -> tuple[Any, Any]:
    """True and predicted states [100, B, ...] of the first episodes."""
    from orbisim_world_model.entities import Entities
    from orbisim_world_model.sampling import Windows
    from orbisim_world_model.unroll import open_loop

    model = checkpoint.model.to(pack.device)
    part = pack.subset(torch.nonzero(pack.length >= 100 + burn)[: options.episodes, 0])
    windows = Windows(part, 100 + burn, model.config)
    first = torch.cat([torch.zeros_like(part.start[:1]), windows.ends[:-1]])
    batch = windows.batch(*windows.locate(first))
    start = disturb(batch.states.at(burn)) if disturb else None
    predicted = open_loop(model, batch, burn, start)
    return Entities(*(field[burn + 1 :] for field in batch.states)), predicted


def _entities(layout: Any, run: Any) -> Any:
    from orbisim_world_model.entities import Entities

    arrays = [torch.as_tensor(a).float().transpose(0, 1) for a in (run.qpos, run.qvel, run.act)]
    flat = layout.split(*(a.flatten(0, 1) for a in arrays))
    return Entities(*(field.unflatten(0, arrays[0].shape[:2]) for field in flat))


if __name__ == "__main__":
    sys.exit(main())
