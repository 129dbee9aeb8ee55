"""Whether a learned step holds: long rollouts of `push` beside C MuJoCo's.

    python tools/eval_holds.py --checkpoint CHECKPOINT --data DIR [--episodes 200] [--steps 2000]
        [--mujoco MM ...] [--keep FILE.npz] [--file push_test.h5]

Four kinds of episodes, a quarter each: `rest` (nothing moves), `hold` (random motion that ends),
`roam` (a random policy), `strokes` (a scripted one, push after push). Truth is collected by C
MuJoCo into DIR, with seeds that no training has, unless it is there already. The rollouts run
through the backend, open loop from the first state, each world with its own descriptors. With
`--file`, the same of that file's episodes instead, as far as the shortest goes.

Printed as JSON, median, 90 % and worst over the episodes of each kind:
  joints_rad: largest error of an arm's joint at any step. fingers_mm: likewise of the fingers.
  creep_mm: how far a cube that MuJoCo leaves alone (less than 0.1 mm) gets from its start.
  cubes_mm at 100, 500, 1,000 and all steps: the worse of the cubes.
covered, at the same steps: the shares of the cubes' 90 % intervals of position and rotation that
hold the truth (covered_wider: of their 99 % intervals, by which the backend warns); and counts of
episodes: ghosts (a cube that MuJoCo leaves alone moves more than 5 mm), left (a cube leaves the
table that does not in MuJoCo), failed (a cube off by 5 cm or 20 degrees, or a joint by 0.05 rad, at
some step), silent (failed, and at the first such step there was no warning of its world, no
divergence, and no 90 % interval that reached that far: what the backend itself warns by is the
fourth limit of `warned`).

With `--mujoco`, the same of C MuJoCo from starts in which cubes are off by a normal error of so
many mm along each axis of the table, and so many degrees about the vertical (0: by what single
precision rounds away): what fails there can be told from such starts by nobody.

`warned`, of a checkpoint: what other limits of the intervals would do, as shares of 5 cm and 20
degrees, over the first 100, 500, 1,000 and all steps: the number of episodes that `failed` by then;
of these the `silent`, to which no warning, divergence or interval (of the hand or a cube) beyond
the limit came at or before the failure; and of the others, the `false` ones, of which one came.
`--keep` writes what this is made of, in half precision, for each kind `KIND/...`: `error` [B, T+1],
the largest of the errors over what counts as failed; `width` [B, T, K], the half-widths of hand and
cubes over 5 cm and 20 degrees, the larger of the two; `said` [B], the number of the first state
that left the training data or diverged (inf for none).
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import eval_push  # noqa: E402  (needs the path above)
import from_source  # noqa: E402
from orbisim_world_model.packing import read_data  # noqa: E402
from orbisim_world_model.spread import WIDER  # noqa: E402

from orbisim import load_scene, make_backend  # noqa: E402
from orbisim.cli.common import quiet_engine  # noqa: E402
from orbisim.state import State  # noqa: E402
from orbisim.tasks.collect import collect  # noqa: E402
from orbisim.tasks.tabletop import on_table  # noqa: E402

KINDS = ("rest", "hold", "roam", "strokes")
SEED = 20_26
STILL, GHOST, FAR, TURNED, OFF = 1e-4, 5e-3, 0.05, np.deg2rad(20.0), 0.05
"""m, m, m, rad, rad: see above."""
ARM = 6
SHARES = (1.0, 0.7, 0.5, round(1 / WIDER, 3), 0.25, 0.18, 0.13, 0.09, 0.06, 0.04, 0.03, 0.02)
"""Of `FAR` and `TURNED`, by about the square root of two; the fourth is the backend's own limit."""


def main() -> None:
    """Collects, rolls out, prints."""
    options = _parser().parse_args()
    options.data.mkdir(parents=True, exist_ok=True)
    from_source.register("mujoco", "learned")
    result: dict[str, Any] = {"checkpoint": str(options.checkpoint), "steps": options.steps}
    kept: dict[str, Any] = {}
    for kind in [options.file.stem] if options.file else options.kinds.split(","):
        pack = read_data([options.file]) if options.file else _pack(options, kind)
        if options.truth_only:
            continue
        runs: dict[str, Callable[[], dict[str, Any]]] = {}
        if options.checkpoint:
            runs[kind] = functools.partial(rolled_out, options, pack)
        for off in options.mujoco:
            name = f"{kind}, mujoco off by {off:g} mm"
            runs[name] = functools.partial(simulated, pack, off)
        for name, run in runs.items():
            began = time.monotonic()
            found = run()
            result[name] = figures(found)
            spent = round(time.monotonic() - began, 1)
            print(json.dumps({name: result[name], "seconds": spent}), flush=True)
            kept |= {f"{name}/{key}": _half(value) for key, value in signals(found).items()}
            if options.out:
                options.out.write_text(json.dumps(result, indent=1))
            if options.keep:
                np.savez_compressed(options.keep, **kept)


def _pack(options: Any, kind: str) -> Any:
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


def simulated(pack: Any, off: float) -> dict[str, Any]:
    """The same of C MuJoCo from disturbed starts (see `--mujoco`), which says nothing of itself."""
    length = int(pack.length.min())
    rows = pack.start[:, None] + torch.arange(length + 1)
    found, _ = eval_push.simulated(pack, length, off, burn=0)
    return {
        "truth": pack.qpos[rows].double().numpy(),
        "found": found[rows].double().numpy(),
        "warnings": 0,
        "diverged_at": np.full(pack.episodes, -1),
        "outside_at": None,
        "interval": None,
    }


def _steps(times: Any, duration: float) -> Any:
    """Numbers of states [B, K] from their times; None for None."""
    return None if times is None else _host(times) / duration


def _host(values: Any) -> Any:
    return values.cpu().numpy() if hasattr(values, "cpu") else values


@dataclasses.dataclass(frozen=True)
class Errors:
    """How far a run is off after each step.

    Attributes:
      arm: [B, T+1], rad, the largest of its joints. place, turn: [B, T+1, N], m and rad, of cubes.
      lost: [B, T+1], whether it is no state at all.
    """

    arm: Any
    place: Any
    turn: Any
    lost: Any

    @property
    def failed(self) -> Any:
        """[B, T+1]: see above."""
        far = (self.place > FAR) | (self.turn > TURNED)
        return far.any(-1) | (self.arm > OFF) | self.lost

    @property
    def share(self) -> Any:
        """[B, T+1]: the largest error over what counts as failed; inf for what is lost."""
        cubes = np.maximum(self.place / FAR, self.turn / TURNED).max(-1)
        return np.where(self.lost, np.inf, np.maximum(cubes, self.arm / OFF))


def errors_of(run: dict[str, Any]) -> Errors:
    """Of true and found coordinates."""
    truth, found = run["truth"], run["found"]
    there, cubes = _cubes(truth), _cubes(found)
    return Errors(
        np.abs(found - truth)[..., :ARM].max(-1),
        np.linalg.norm(cubes[..., :3] - there[..., :3], axis=-1),
        _angle(cubes[..., 3:], there[..., 3:]),
        ~np.isfinite(found).all(-1),
    )


def figures(run: dict[str, Any]) -> dict[str, Any]:
    """What is printed of one kind of episodes."""
    truth, found = run["truth"], run["found"]
    errors = errors_of(run)
    arm, place, turn = errors.arm, errors.place, errors.turn
    there, cubes = _cubes(truth), _cubes(found)
    alone: Any = (
        np.linalg.norm(there[..., :3] - there[:, :1, :, :3], axis=-1).max(1) < STILL
    )  # [B, N]
    gone = np.linalg.norm(cubes[..., :3] - cubes[:, :1, :, :3], axis=-1).max(1)
    creep = np.where(alone, gone, 0.0).max(1)[alone.any(1)]
    left = on_table(there[..., :3]).all(1) & ~on_table(cubes[..., :3]).all(1)
    failed = errors.failed
    marks = sorted({min(m, truth.shape[1] - 1) for m in (100, 500, 1000, truth.shape[1] - 1)})
    signal = signals(run)
    return {
        "episodes": len(truth),
        "joints_rad": _row(arm.max(1)),
        "fingers_mm": _row(np.abs(found - truth)[..., ARM : ARM + 2].max((1, 2)) * 1e3),
        "creep_mm": _row(creep * 1e3),
        "cubes_alone": int(alone.sum()),
        "cubes_mm": {str(m): _row(place[:, m].max(1) * 1e3) for m in marks},
        "cubes_deg": {str(m): _row(np.rad2deg(turn[:, m].max(1))) for m in marks},
        "covered": {str(m): covered(run["interval"], place, turn, m) for m in marks},
        "covered_wider": {str(m): covered(run["interval"], place, turn, m, WIDER) for m in marks},
        "ghosts": int((alone & ~(gone < GHOST)).any(1).sum()),
        "left": int(left.any(1).sum()),
        "failed": int(failed.any(1).sum()),
        "failed_by": {str(m): int(failed[:, : m + 1].any(1).sum()) for m in marks},
        "diverged": int((run["diverged_at"] >= 0).sum()),
        "silent": int(silent(run, failed, place, turn, arm).sum()),
        "warned": {str(m): warned(signal, m) for m in marks} if "width" in signal else None,
        "warnings": run["warnings"],
    }


def signals(run: dict[str, Any]) -> dict[str, Any]:
    """What `--keep` writes; no `width` of what gives no intervals."""
    errors = errors_of(run)
    diverged = np.where(run["diverged_at"] < 0, np.inf, run["diverged_at"] + 1.0)
    said = diverged
    if run["outside_at"] is not None:
        said = np.minimum(said, run["outside_at"].min(1))
    found = {"error": errors.share, "said": said}
    if run["interval"] is not None:
        width = run["interval"] / np.array([FAR, TURNED])
        found["width"] = np.nan_to_num(width.max(3), nan=np.inf)
    return found


def _half(values: Any) -> Any:
    with np.errstate(over="ignore"):
        return np.asarray(values).astype(np.float16)


def warned(signal: dict[str, Any], steps: int) -> dict[str, dict[str, int]]:
    """`failed`, and by the limits' shares `silent` and `false` over the first steps (see above)."""
    fails = signal["error"][:, : steps + 1] > 1.0
    first = np.where(fails.any(1), fails.argmax(1), np.inf)
    last = np.minimum(first, steps)  # what is said later says nothing of the first steps
    result = {"failed": {"episodes": int(fails.any(1).sum())}}
    for share in SHARES:
        wide = (signal["width"][:, :steps] > share).any(2)
        at = np.where(wide.any(1), wide.argmax(1) + 1.0, np.inf)
        told = np.minimum(at, signal["said"]) <= last + 0.5
        result[f"{share:g}"] = {
            "silent": int((fails.any(1) & ~told).sum()),
            "false": int((~fails.any(1) & told).sum()),
        }
    return result


def covered(
    interval: Any, place: Any, turn: Any, step: int, times: float = 1.0
) -> list[float] | None:
    """Shares of the cubes whose errors are within so many times the intervals after a step; None
    without any."""
    if interval is None:
        return None
    width = (
        times * interval[:, step - 1, -place.shape[2] :]
    )  # [B, N, 2]; what diverged is not covered
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
    parser.add_argument("--mujoco", type=float, nargs="*", default=[], help="mm")
    parser.add_argument("--keep", type=Path, help="an .npz of errors, widths and warnings")
    parser.add_argument("--data", type=Path, default=Path(), help="folder for the truth")
    parser.add_argument("--file", type=Path, help="episodes of task:push or push_hold instead")
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
