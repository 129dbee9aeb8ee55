"""Images whose cubes are drawn anew each, for the training of StaInf.

    MUJOCO_GL=egl python tools/collect_stills.py --out DIR --episodes 800 [--seconds 120]
        [--workers 16]
    orbisim train inference CHECKPOINT DIR/*.stills.npz --held-out-data data/val_push.h5

Each file has the states of one episode of `push` (three of four) or `push_cubes`, 49 kB an image.
Files that exist are kept; with `--seconds` no further one is begun after that time.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

from orbisim_diffusion.stills import SUFFIX, make_stills

from orbisim.cli.common import quiet_engine
from orbisim.tasks import pool

TRAIN = 200
"""Seed; other collections of images have 100 to 160."""
_KINDS = (("push", "to_hit"), ("push", "push"), ("push", "random"), ("push_cubes", "random"))
"""Task and subtask of episode number 0, 1, 2, 3 and so on in turn."""


def main() -> None:
    """Makes the files; prints a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True, help="folder for the files")
    parser.add_argument("--episodes", type=int, default=800)
    parser.add_argument("--seconds", type=float, default=1e9, help="no file is begun after")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seed", type=int, default=TRAIN)
    parser.add_argument("--size", type=int, default=128, help="height and width, pixels")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    begun = time.time()
    jobs: list[tuple[Any, ...]] = [
        (number, arguments.seed, arguments.size, arguments.out, begun + arguments.seconds)
        for number in range(arguments.episodes)
    ]
    with quiet_engine():
        for _ in pool.run(one, jobs, arguments.workers):
            pass
    line = {"files": len(list(arguments.out.glob(f"*{SUFFIX}")))}
    print(json.dumps({**line, "seconds": round(time.time() - begun, 1)}))


def one(number: int, seed: int, size: int, out: Path, end: float) -> None:
    """Makes a file, unless it is there or the time is over."""
    path = out / f"{number:05d}{SUFFIX}"
    if path.exists() or time.time() > end:
        return
    task, subtask = _KINDS[number % len(_KINDS)]
    make_stills(task, subtask, seed, number, path, size=size)


if __name__ == "__main__":
    main()
