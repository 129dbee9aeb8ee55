"""Collects the images that the diffusion renderer is trained and measured on.

    MUJOCO_GL=egl python tools/collect_vision.py --out DIR [--workers 16] [--scale 1.0]
        [--only 'train_push_?' test_push]

Train, validation and test have different seeds; the sets whose names begin with `ood` lie outside
the training distribution in one respect each. Sets are made in the order in which they are named.
Files that exist are kept; an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import dataclasses
import fnmatch
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orbisim.cli.common import quiet_engine
from orbisim.tasks.collect import collect
from orbisim.tasks.frames import RANDOM, Camera

TRAIN, VALIDATION, TEST = 100, 101, 102
"""Seeds; others than those of the dynamics' data."""


@dataclasses.dataclass(frozen=True)
class DataSet:
    """One file: its name, the task, and what `collect` is told."""

    name: str
    task: str
    episodes: int
    seed: int = TRAIN
    subtask: str | None = None
    camera: str = "side"
    buffers: bool = False
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)


def data_sets() -> list[DataSet]:
    """All of them; test sets also keep depth and segmentation."""
    held = {"seed": TEST, "buffers": True}
    outside: dict[str, Any] = {"task": "push", "episodes": 50, **held}
    return [
        *(DataSet(f"train_push_{i}", "push", 80, TRAIN + 10 * i) for i in range(1, 7)),
        DataSet("train_push_cubes", "push_cubes", 240),
        DataSet("train_pick_and_place", "pick_and_place", 160),
        DataSet("train_push_random", "push", 160, camera=RANDOM),
        DataSet("val_push", "push", 40, VALIDATION),
        DataSet("test_push", "push", 200, **held),
        DataSet("test_push_cubes", "push_cubes", 50, **held),
        DataSet("test_pick_and_place", "pick_and_place", 40, **held),
        DataSet("test_push_random", "push", 50, camera=RANDOM, **held),
        DataSet("ood_count", subtask="three", **outside),
        DataSet("ood_slippery", subtask="to_hit", changes={"table_friction": 0.05}, **outside),
        DataSet("ood_rough", subtask="to_hit", changes={"table_friction": 1.0}, **outside),
        DataSet("ood_shape", subtask="to_hit", changes={"aspect": (0.45, 0.65)}, **outside),
    ]


def main() -> None:
    """Collects them one after another; prints a line of JSON for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True, help="folder for the files")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of episodes")
    parser.add_argument("--size", type=int, default=128, help="height and width, pixels")
    parser.add_argument("--only", nargs="+", default=["*"], help="names; * and ? stand for letters")
    parser.add_argument("--no-buffers", action="store_true", help="no depth and segmentation")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    with quiet_engine():
        for item in wanted(arguments.only):
            path = arguments.out / f"{item.name}.h5"
            if not path.exists():
                print(json.dumps(one(item, path, arguments)), flush=True)
    print(json.dumps({"name": "all", "seconds": round(time.monotonic() - started, 1)}))


def wanted(names: Sequence[str]) -> list[DataSet]:
    """The data sets of those names, in their order."""
    found = [item for name in names for item in data_sets() if fnmatch.fnmatch(item.name, name)]
    return list({item.name: item for item in found}.values())


def one(item: DataSet, path: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Collects one data set; returns what is worth printing."""
    result = collect(
        item.task,
        path,
        episodes=max(1, round(item.episodes * arguments.scale)),
        seed=item.seed,
        workers=arguments.workers,
        subtask=item.subtask,
        camera=Camera(item.camera, arguments.size, item.buffers and not arguments.no_buffers),
        changes=item.changes,
    )
    return {
        "name": item.name,
        "episodes": result.episodes,
        "frames": result.steps + result.episodes,
        "seconds": result.seconds,
        "megabytes": round(path.stat().st_size / 1e6, 1),
    }


if __name__ == "__main__":
    main()
