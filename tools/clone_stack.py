"""Behaviour cloning of `task:stack` from adapted demonstrations that succeed, judged in C MuJoCo.

    orbisim collect task:stack --subtask adapted --out stack_train.h5      # 2,200 episodes
    python tools/clone_stack.py train --data stack_train.h5 --out clone
    python tools/clone_stack.py eval --policy clone --episodes 200 --workers 4 --json clone.json

    MUJOCO_GL=egl python tools/clone_stack.py draw --data stack_train.h5 --out images --workers 14
    python tools/clone_stack.py look --images images --out eyes --device cuda
    MUJOCO_GL=egl python tools/clone_stack.py eval --policy clone --eyes eyes --workers 14

The policy sees where the tool is told to be, the fingers, the cubes' poses about the one that the
hand is about and turned with it, since when its grip is as it is, and the number of the
demonstration that it follows: of the ten from which episodes are adapted (in `eval` drawn as often
as it is among those it was trained on). It tells where the tool shall be in the next ten control
steps. With `--noise S` each position of a cube is measured with a normal error of S m, and each
angle with one of 2 S / 0.01 degrees, drawn anew at every look, in training or, given to `eval`,
when it acts. With `--eyes` the cubes' poses are read off images of two cameras, 128 x 128 pixels,
by a network that `look` trains on images of the demonstrations; cubes are red, green and blue in
their order. `eval` plays episodes of 300 control steps that no demonstration has seen, in
distribution and out of it (OUTSIDE).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

from cloning import eyes, policy  # noqa: E402  (needs the path above)
from cloning.world import play  # noqa: E402
from orbisim_policies.evaluate import wilson  # noqa: E402
from processes import spawned  # noqa: E402

from orbisim.files.reading import read_json  # noqa: E402
from orbisim.tasks.sampling import episode_seed  # noqa: E402

OUTSIDE: dict[str, dict[str, Any]] = {
    "in distribution": {},
    "smaller cubes (40 mm)": {"cube_half": (0.02, 0.02)},
    "larger cubes (50 mm)": {"cube_half": (0.025, 0.025)},
    "a wider area": {"x": (0.33, 0.68), "y": (-0.3, 0.3)},
    "slippery (0.05 to 0.15)": {"cube_friction": (0.05, 0.15), "table_friction": (0.05, 0.15)},
}
"""Changes to `StackConfig`. In distribution cubes have 45 mm and friction 0.2 to 0.6, and lie
within x 0.4 to 0.6 and y -0.22 to 0.22 m."""


def evaluate(options: Any) -> dict[str, Any]:
    """Shares of success in and out of distribution."""
    result: dict[str, Any] = {"policy": read_json(options.policy / "manifest.json")}
    if options.eyes:
        result["eyes"] = read_json(options.eyes / "manifest.json")
    result |= {"noise": options.noise, "episodes": options.episodes}
    for name, changes in OUTSIDE.items():
        if options.only and name not in options.only:
            continue
        numbers = range(options.episodes)
        seeds = [episode_seed(options.seed, "stack", "clones", i) for i in numbers]
        parts = [seeds[i : i + options.at_once] for i in range(0, len(seeds), options.at_once)]
        jobs = [(options.policy, changes, part, options.noise, options.eyes) for part in parts]
        if options.workers > 1:
            with spawned(options.workers) as pool:
                played = list(pool.map(play, *zip(*jobs, strict=True)))
        else:
            played = [play(*job) for job in jobs]
        each = [one for part in played for one in part]
        wins = sum(good for good, _, _ in each)
        result[name] = {
            "success": wins / len(each),
            "ci95": wilson(wins, len(each)),
            "first cube stacked": float(np.mean([count > 0 for _, count, _ in each])),
            "each": each,
        }
        told = {key: value for key, value in result[name].items() if key != "each"}
        print(json.dumps({name: told}), flush=True)
        if options.json:
            options.json.write_text(json.dumps(result))
    return result


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="what", required=True)
    training = commands.add_parser("train")
    training.add_argument("--data", type=Path, required=True)
    training.add_argument("--out", type=Path, required=True)
    training.add_argument("--demonstrations", type=int, help="at most; all that succeed if absent")
    training.add_argument("--anonymous", action="store_true", help="not told which demonstration")
    training.add_argument(
        "--stray", type=float, default=1.0, help="times as far as usual; 0: never"
    )
    training.add_argument("--steps", type=int, default=20_000)
    drawing = commands.add_parser("draw")
    drawing.add_argument("--data", type=Path, required=True)
    drawing.add_argument("--out", type=Path, required=True)
    drawing.add_argument("--demonstrations", type=int, default=400)
    drawing.add_argument("--workers", type=int, default=1)
    looking = commands.add_parser("look")
    looking.add_argument("--images", type=Path, required=True)
    looking.add_argument("--out", type=Path, required=True)
    looking.add_argument("--steps", type=int, default=10_000)
    looking.add_argument("--batch", type=int, default=256)
    looking.add_argument("--time-limit", type=float, default=1e9, help="seconds of training")
    playing = commands.add_parser("eval")
    playing.add_argument("--policy", type=Path, required=True)
    playing.add_argument("--eyes", type=Path)
    playing.add_argument("--episodes", type=int, default=200)
    playing.add_argument("--only", nargs="*", default=[])
    playing.add_argument("--workers", type=int, default=1)
    playing.add_argument("--at-once", type=int, default=10, help="episodes side by side")
    playing.add_argument("--json", type=Path)
    for one in (training, playing):
        one.add_argument("--noise", type=float, default=0.0, help="m")
    for one in (training, looking, playing):
        one.add_argument("--seed", type=int, default=0)
    for one in (training, looking):
        one.add_argument("--device", default="cpu")
    options = parser.parse_args()
    if options.what == "train":
        print(json.dumps(policy.train(options.data, options.out, options)))
    elif options.what == "draw":
        eyes.draw(options)
    elif options.what == "look":
        print(json.dumps(eyes.train(options)))
    else:
        evaluate(options)


if __name__ == "__main__":
    main()
