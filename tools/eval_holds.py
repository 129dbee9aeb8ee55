"""Whether a learned step holds: long rollouts of `push` beside C MuJoCo's.

    python tools/eval_holds.py --checkpoint CHECKPOINT --data DIR [--episodes 200] [--steps 2000]

Four kinds of episodes, a quarter each: `rest` (nothing moves), `hold` (random motion that ends),
`roam` (a random policy), `strokes` (a scripted one, push after push). Truth is collected by C
MuJoCo into DIR, with seeds that no training has, unless it is there already. The rollouts run
through the backend, open loop from the first state, each world with its own descriptors.

Printed as JSON, median, 90 % and worst over the episodes of each kind:
  joints_rad: largest error of an arm's joint at any step. fingers_mm: likewise of the fingers.
  creep_mm: how far a cube that MuJoCo leaves alone (less than 0.1 mm) gets from its start.
  cubes_mm at 100, 500, 1,000 and all steps: the worse of the cubes.
covered, at the same steps: the shares of the cubes' 90 % intervals of position and rotation that
hold the truth; and counts of episodes: ghosts (a cube that MuJoCo leaves alone moves more than
5 mm), left (a cube leaves the table that does not in MuJoCo), failed (a cube off by 5 cm or 20
degrees, or a joint by 0.05 rad, at some step), silent (failed, and at the first such step there was
no warning of its world, no divergence, and no 90 % interval that reached that far).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

import from_source  # noqa: E402

from orbisim import load_scene, make_backend  # noqa: E402  (needs the path above)
from orbisim.cli.common import quiet_engine  # noqa: E402
from orbisim.state import State  # noqa: E402
from orbisim.tasks.collect import collect  # noqa: E402
from orbisim.tasks.tabletop import on_table  # noqa: E402

KINDS = ("rest", "hold", "roam", "strokes")
SEED = 20_26
STILL, GHOST, FAR, TURNED, OFF = 1e-4, 5e-3, 0.05, np.deg2rad(20.0), 0.05
"""m, m, m, rad, rad: see above."""
ARM = 6


def main() -> None:
    """Collects, rolls out, prints."""
    options = _parser().parse_args()
    options.data.mkdir(parents=True, exist_ok=True)
    from_source.register("mujoco", "learned")
    result: dict[str, Any] = {"checkpoint": str(options.checkpoint), "steps": options.steps}
    for kind in options.kinds.split(","):
        began = time.monotonic()
        pack = _pack(options, kind)
        if options.truth_only:
            continue
        rows = figures(rolled_out(options, pack))
        result[kind] = rows
        print(json.dumps({kind: rows, "seconds": round(time.monotonic() - began, 1)}), flush=True)
    if options.out:
        options.out.write_text(json.dumps(result, indent=1))


def _pack(options: Any, kind: str) -> Any:
    from orbisim_world_model.packing import read_data

    path = options.data / f"holds_{kind}_{options.steps}.h5"
    if not path.exists():
        count = max(1, options.episodes // len(KINDS))
        with quiet_engine():
            collect(
                "push_hold",
                path,
                episodes=count,
                seed=SEED,
                workers=options.workers,
                subtask=kind,
                changes={"steps": options.steps},
            )
    return read_data([path])


def rolled_out(options: Any, pack: Any) -> dict[str, Any]:
    """True and predicted coordinates [B, T+1, nq], and what the backend said of them."""
    length, count = int(pack.length.min()), pack.episodes
    rows = pack.start[:, None] + torch.arange(length + 1)
    truth, speed = pack.qpos[rows].double().numpy(), pack.qvel[rows].double().numpy()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        scene = load_scene("task:push")
        name, on = f"learned:{options.checkpoint}", options.device
        backend = make_backend(name, scene, device=on, compiled=False)
        start = State(np.zeros(count), truth[:, 0], speed[:, 0], np.zeros((count, 0)))
        start = backend.with_descriptors(
            start, attributes=pack.attributes.numpy(), settings=pack.world.numpy()
        )
        path = backend.rollout(start, pack.ctrl[rows[:, :-1]].double().numpy())
    found = path.qpos.cpu().numpy() if hasattr(path.qpos, "cpu") else np.asarray(path.qpos)
    memory = path.final.memory
    return {
        "truth": truth,
        "found": np.concatenate([truth[:, :1], found], axis=1),
        "warnings": len(said),
        "diverged_at": path.diverged_at,
        "outside_at": _steps(memory.get("world_model_outside"), backend.timestep),
        "interval": _host(memory.get("world_model_uncertainty")),
    }


def _steps(times: Any, duration: float) -> Any:
    """Numbers of states [B, K] from their times; None for None."""
    return None if times is None else _host(times) / duration


def _host(values: Any) -> Any:
    return values.cpu().numpy() if hasattr(values, "cpu") else values


def figures(run: dict[str, Any]) -> dict[str, Any]:
    """What is printed of one kind of episodes."""
    truth, found = run["truth"], run["found"]
    lost = ~np.isfinite(found).all(-1)  # [B, T+1]
    there, cubes = _cubes(truth), _cubes(found)
    arm = np.abs(found - truth)[..., :ARM].max(-1)
    place = np.linalg.norm(cubes[..., :3] - there[..., :3], axis=-1)  # [B, T+1, N]
    turn = _angle(cubes[..., 3:], there[..., 3:])
    alone = np.linalg.norm(there[..., :3] - there[:, :1, :, :3], axis=-1).max(1) < STILL  # [B, N]
    gone = np.linalg.norm(cubes[..., :3] - cubes[:, :1, :, :3], axis=-1).max(1)
    creep = np.where(alone, gone, 0.0).max(1)[alone.any(1)]
    left = on_table(there[..., :3]).all(1) & ~on_table(cubes[..., :3]).all(1)
    bad = (place > FAR) | (turn > TURNED)
    failed = bad.any(-1) | (arm > OFF) | lost
    marks = sorted({min(m, truth.shape[1] - 1) for m in (100, 500, 1000, truth.shape[1] - 1)})
    return {
        "episodes": len(truth),
        "joints_rad": _row(arm.max(1)),
        "fingers_mm": _row(np.abs(found - truth)[..., ARM : ARM + 2].max((1, 2)) * 1e3),
        "creep_mm": _row(creep * 1e3),
        "cubes_alone": int(alone.sum()),
        "cubes_mm": {str(m): _row(place[:, m].max(1) * 1e3) for m in marks},
        "cubes_deg": {str(m): _row(np.rad2deg(turn[:, m].max(1))) for m in marks},
        "covered": {str(m): covered(run["interval"], place, turn, m) for m in marks},
        "ghosts": int((alone & ~(gone < GHOST)).any(1).sum()),
        "left": int(left.any(1).sum()),
        "failed": int(failed.any(1).sum()),
        "diverged": int((run["diverged_at"] >= 0).sum()),
        "silent": int(silent(run, failed, place, turn, arm).sum()),
        "warnings": run["warnings"],
    }


def covered(interval: Any, place: Any, turn: Any, step: int) -> list[float] | None:
    """Shares of the cubes whose errors are within the intervals after a step; None without any."""
    if interval is None:
        return None
    width = interval[:, step - 1, -place.shape[2] :]  # [B, N, 2]; what diverged is not covered
    pairs = ((place, width[..., 0]), (turn, width[..., 1]))
    return [float((error[:, step] <= most).mean()) for error, most in pairs]


def silent(run: dict[str, Any], failed: Any, place: Any, turn: Any, arm: Any) -> Any:
    """[B]: whether an episode failed without a word (see above)."""
    first = failed.argmax(1)
    worlds = np.arange(len(failed))
    quiet = failed.any(1)
    diverged = run["diverged_at"]
    quiet &= ~((diverged >= 0) & (diverged + 1 <= first))
    if run["outside_at"] is not None:
        quiet &= ~(run["outside_at"].min(1) <= first + 0.5)
    if run["interval"] is not None:
        at = run["interval"][worlds, np.maximum(first - 1, 0)]  # [B, K, 2], m and rad
        known = (at[..., 0] > FAR) | (at[..., 1] > TURNED)
        quiet &= ~known.any(1)
    return quiet


def _cubes(qpos: Any) -> Any:
    return qpos[..., ARM + 2 :].reshape(*qpos.shape[:2], -1, 7)


def _angle(a: Any, b: Any) -> Any:
    return 2 * np.arccos(np.clip(np.abs((a * b).sum(-1)), 0.0, 1.0))


def _row(values: Any) -> dict[str, float]:
    values = np.nan_to_num(np.asarray(values, float), nan=np.inf)
    if not values.size:
        return {}
    return {
        "median": float(np.median(values)),
        "p90": float(np.quantile(values, 0.9, method="higher")),
        "worst": float(values.max()),
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--data", type=Path, required=True, help="folder for the truth")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--truth-only", action="store_true", help="collect, and no more")
    parser.add_argument("--out", type=Path)
    return parser


if __name__ == "__main__":
    main()
