"""Collects every data set that the learned models are trained and measured on.

    python tools/collect_all.py --out DIR [--workers 16] [--scale 1.0] [--only NAME ...]

Counts are the paper's where it has them. Held-out sets have other seeds than the training sets.
Files that exist are kept; an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time
from pathlib import Path
from typing import Any

from orbisim.cli.common import quiet_engine
from orbisim.tasks.collect import collect
from orbisim.tasks.domains import HELD_OUT_MECHANISMS, MECHANISMS, SUBSTEPS, SUITE_TASKS

TRAIN, TEST, MORE, CALIBRATION, EXTRA = 0, 1, 5, 3, 6
"""Seeds."""

MANY = {"acrobot": 2000, "finger": 1200, "cheetah": 2000, "hopper": 1000, "walker": 1000}
"""Training episodes of the suite where a thousand of 250 control steps are too few; of 500 each."""


@dataclasses.dataclass(frozen=True)
class DataSet:
    """One file: its name, the task, and what `collect` is told."""

    name: str
    task: str
    episodes: int | None = None
    seed: int = TRAIN
    subtask: str | None = None
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)


def data_sets() -> list[DataSet]:
    """All of them."""
    hit = {"task": "push", "seed": TEST, "subtask": "to_hit"}
    # a model that knows no actuator's limit must not see two grippers: these have that of `push`
    strong = {"force": 60.0}
    throws = {"task": "shove", "subtask": "thrown", "changes": strong}
    sets = [
        DataSet("push_train", "push"),
        DataSet("push_test", "push", 260, TEST),
        DataSet("push_calibration", "push", 260, CALIBRATION),
        DataSet("push_hold_train", "push_hold"),
        DataSet("push_long_train", "push_hold", 250, MORE, changes={"steps": 500}),
        DataSet("push_long_calibration", "push_hold", 60, CALIBRATION, changes={"steps": 500}),
        DataSet("push_more_train", "push", seed=MORE),
        DataSet("push_extra_train", "push", seed=EXTRA),
        DataSet("push_low_friction", episodes=100, changes={"table_friction": 0.2}, **hit),
        DataSet("push_high_friction", episodes=100, changes={"table_friction": 0.6}, **hit),
        DataSet("push_ood_slippery", episodes=100, changes={"table_friction": 0.05}, **hit),
        DataSet("push_ood_rough", episodes=100, changes={"table_friction": 1.0}, **hit),
        DataSet("push_ood_three", "push", 100, TEST, "three"),
        DataSet("shove_train", **throws),
        DataSet("shove_test", episodes=260, seed=TEST, **throws),
        DataSet("shove_calibration", episodes=260, seed=CALIBRATION, **throws),
        DataSet("shove_more_train", episodes=1000, seed=EXTRA, **throws),
        DataSet("shove_strikes_train", "shove", 300, MORE, "strikes", {"steps": 200, **strong}),
        DataSet("push_cubes_train", "push_cubes"),
        DataSet("push_cubes_test", "push_cubes", 168, TEST),
        DataSet("pick_and_place_train", "pick_and_place"),
        DataSet("pick_and_place_test", "pick_and_place", 126, TEST),
        DataSet("stack_train", "stack", subtask="adapted"),
        DataSet("stack_test", "stack", 200, TEST, "adapted"),
        DataSet("ball_train", "ball"),
        DataSet("ball_many_train", "ball", 8000, 2),
        DataSet("ball_test", "ball", 100, TEST),
        DataSet("toss_train", "toss", 4000),
        DataSet("toss_test", "toss", 200, TEST),
    ]
    for name in SUITE_TASKS:
        short, task = name.partition("-")[0], f"suite:{name}"
        fine = {"substeps": SUBSTEPS.get(short, 1)}
        train = {**fine, "steps": 500} if short in MANY else fine
        sets.append(DataSet(f"suite_{short}_train", task, MANY.get(short, 1000), changes=train))
        long = {**fine, "steps": 1000}
        sets.append(DataSet(f"suite_{short}_test", task, 40, TEST, changes=long))
        brief = {**fine, "steps": 100}
        sets.append(DataSet(f"suite_{short}_calibration", task, 100, CALIBRATION, changes=brief))
    for subtask in ("primitives", "meshes", "unseen"):
        drape = {"task": "drape", "subtask": subtask}
        if subtask != "unseen":
            sets.append(DataSet(f"drape_{subtask}_train", **drape))
        sets.append(DataSet(f"drape_{subtask}_test", episodes=40, seed=TEST, **drape))
    return sets + _mechanisms()


def _mechanisms() -> list[DataSet]:
    """Instances to learn from and others; of families that are held out, only to look at."""
    sets = []
    for family in MECHANISMS:
        name, task = f"mechanism_{family}", f"task:mechanism:{family}"
        if family not in HELD_OUT_MECHANISMS:
            tries = {"release": 0.7}  # what a lock holds shows where nothing releases it
            sets.append(DataSet(f"{name}_train", task, subtask="train", changes=tries))
        held = {"task": task, "seed": TEST, "subtask": "held_out"}
        sets.append(DataSet(f"{name}_test", **held))
        sets.append(DataSet(f"{name}_locked", changes={"release": 0.0}, **held))
    return sets


def main() -> None:
    """Collects them one after another; prints a line of JSON for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True, help="folder for the files")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of episodes")
    parser.add_argument("--test-seed", type=int, default=TEST, help="of held-out sets, fresh ones")
    parser.add_argument("--only", nargs="+", default=[], help="names, or beginnings of names")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    with quiet_engine():
        for item in data_sets():
            if item.seed == TEST:
                item = dataclasses.replace(item, seed=arguments.test_seed)
            wanted = not arguments.only or item.name.startswith(tuple(arguments.only))
            path = arguments.out / f"{item.name}.h5"
            if wanted and not path.exists():
                print(json.dumps(one(item, path, arguments.scale, arguments.workers)), flush=True)
    print(json.dumps({"name": "all", "seconds": round(time.monotonic() - started, 1)}))


def one(item: DataSet, path: Path, scale: float, workers: int) -> dict[str, Any]:
    """Collects one data set; returns what is worth printing."""
    from orbisim.tasks import make

    total = item.episodes or len(make(item.task).allotment(None, item.subtask))
    result = collect(
        item.task,
        path,
        episodes=max(1, round(total * scale)),
        seed=item.seed,
        workers=workers,
        subtask=item.subtask,
        changes=item.changes,
    )
    return {
        "name": item.name,
        "episodes": result.episodes,
        "steps": result.steps,
        "seconds": result.seconds,
        "megabytes": round(path.stat().st_size / 1e6, 1),
        "success": result.success,
    }


if __name__ == "__main__":
    main()
