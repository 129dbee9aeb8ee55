"""Feeds mutated scenes to the readers and counts how they take it.

Usage:
  python tools/fuzz_readers.py --out build/fuzz [--reader mjcf urdf usd] [--count 3000] [FILE ...]

Small built-in scenes, or the files given, are damaged (bytes flipped, spans deleted, doubled or
cut off, tokens swapped, numbers and attributes replaced), one damaged file of a scene at a time,
and go through `orbisim.load_scene` as a user's file would. Every outcome but "loaded" and
"refused" is a fault ("unforeseen" is an error that the reader did not mean to raise); the input is
saved under OUT/failures. The same seed gives the same inputs.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import multiprocessing
import random
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from fuzz_mutations import mutated
from fuzz_seeds import Files, builtin_seeds, seed_of_file, write

MAX_SECONDS = 5.0
MAX_BYTES = 2 * 2**30
HANG_SECONDS = 30.0
FINE = ("loaded", "refused")
OUTCOMES = (
    *FINE,
    "unforeseen",
    "other exception",
    "crash",
    "hang",
    "over 5 s",
    "over 2 GB",
    "several lines",
)

# ---- running -----------------------------------------------------------------------------------


@dataclasses.dataclass
class Outcome:
    """What became of one input."""

    index: int
    outcome: str
    message: str
    seconds: float


def worker(pipe: Connection) -> None:
    """Loads the scenes that come through the pipe; says first that it is ready."""
    from orbisim import load_scene
    from orbisim.errors import InputError
    from orbisim.files.guard import FAILED

    pipe.send(None)
    while (task := pipe.recv()) is not None:
        index, path = task
        start = time.monotonic()
        outcome, message = "loaded", ""
        try:
            load_scene(path)
        except InputError as error:
            outcome, message = "refused", str(error)
            if len(message.splitlines()) != 1:
                outcome = "several lines"
            elif FAILED in message:
                outcome = "unforeseen"
        except BaseException as error:
            outcome, message = "other exception", f"{type(error).__name__}: {error}"
        seconds = time.monotonic() - start
        peak = max(
            resource.getrusage(who).ru_maxrss * 1024
            for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )
        if seconds > MAX_SECONDS and outcome in FINE:
            outcome = "over 5 s"
        elif peak > MAX_BYTES and outcome in FINE:
            outcome = "over 2 GB"
        pipe.send(Outcome(index, outcome, message, seconds))
        if peak > MAX_BYTES:  # the peak stays: start afresh
            return


class Worker:
    """A process that loads scenes, replaced when it is gone."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self.index: int | None = None
        self._start()

    def _start(self) -> None:
        self.pipe, child = self._context.Pipe()
        self._process = self._context.Process(target=worker, args=(child,), daemon=False)
        self._process.start()
        child.close()
        self.pipe.recv()
        self.since = time.monotonic()

    def give(self, index: int, path: Path) -> None:
        """Starts on an input."""
        if not self._process.is_alive():
            self._start()
        self.index, self.since = index, time.monotonic()
        self.pipe.send((index, str(path)))

    def take(self) -> Outcome:
        """The outcome of its input; that of a process that is gone is a crash."""
        index, self.index = self.index, None
        try:
            outcome: Outcome = self.pipe.recv()
            return outcome
        except (EOFError, OSError):
            self._process.join()
            code = self._process.exitcode
            self._start()
            return Outcome(index or 0, "crash", f"exit status {code}", 0.0)

    def end_if_stuck(self) -> Outcome | None:
        """Ends a process that has taken far too long."""
        taken = time.monotonic() - self.since
        if self.index is None or taken < HANG_SECONDS:
            return None
        self._process.kill()
        self._process.join()
        index, self.index = self.index, None
        self._start()
        return Outcome(index, "hang", "", taken)

    def stop(self) -> None:
        """Lets the process end."""
        if self._process.is_alive():
            self.pipe.send(None)
        self._process.join(5)


def run(seeds: Sequence[Files], count: int, seed: int, jobs: int, out: Path) -> list[Outcome]:
    """Runs `count` damaged scenes; saves those that were not taken well."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["orbisim.scene.load", "orbisim.scene.urdf", "yourdfpy"])
    workers = [Worker(context) for _ in range(jobs)]
    outcomes: list[Outcome] = []
    folders: dict[int, Path] = {}
    scratch = Path(tempfile.mkdtemp(prefix="fuzz-"))

    def settle(outcome: Outcome) -> None:
        outcomes.append(outcome)
        folder = folders.pop(outcome.index)
        if outcome.outcome not in FINE:
            target = out / "failures" / f"{out.name}_{outcome.index}"
            shutil.copytree(folder, target, dirs_exist_ok=True)
            (target / "outcome.txt").write_text(f"{outcome.outcome}\n{outcome.message}\n")
            print(f"{outcome.index}: {outcome.outcome}: {outcome.message[:200]}", file=sys.stderr)
        shutil.rmtree(folder)

    waiting = iter(range(count))
    try:
        while len(outcomes) < count:
            for worker_ in workers:
                if worker_.index is None and (index := next(waiting, None)) is not None:
                    rng = random.Random(f"{seed}/{index}")
                    files = mutated(rng.choice(seeds), rng)
                    folder = folders[index] = scratch / str(index)
                    folder.mkdir()
                    worker_.give(index, write(files, folder))
            busy = {worker_.pipe: worker_ for worker_ in workers if worker_.index is not None}
            for pipe in wait(list(busy), timeout=1.0):
                settle(busy[pipe].take())  # type: ignore[index]
            for stuck in filter(None, (worker_.end_if_stuck() for worker_ in workers)):
                settle(stuck)
    finally:
        for worker_ in workers:
            worker_.stop()
        shutil.rmtree(scratch, ignore_errors=True)
    return outcomes


# ---- the report --------------------------------------------------------------------------------


def summary(reader: str, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Counts and the slowest input of one reader."""
    counts = collections.Counter(outcome.outcome for outcome in outcomes)
    contained = sum("crashed on it" in outcome.message for outcome in outcomes)
    slowest = max((outcome.seconds for outcome in outcomes), default=0.0)
    return {
        "reader": reader,
        "inputs": len(outcomes),
        **{name: counts[name] for name in OUTCOMES},
        "parser crashes, contained": contained,
        "slowest_s": round(slowest, 2),
    }


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """The summaries as a table."""
    keys = list(rows[0])
    lines = [f"| {' | '.join(keys)} |", "| --- " * len(keys) + "|"]
    lines += [f"| {' | '.join(str(row[key]) for key in keys)} |" for row in rows]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="scenes to damage instead")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--reader", nargs="+", default=["mjcf", "urdf", "usd"])
    parser.add_argument("--count", type=int, default=3000, help="inputs for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    sets = {"files": [seed_of_file(path) for path in arguments.files]}
    if not arguments.files:
        sets = {reader: builtin_seeds(reader) for reader in arguments.reader}
    rows = []
    for reader, seeds in sets.items():
        out = arguments.out / reader
        out.mkdir(parents=True, exist_ok=True)
        outcomes = run(seeds, arguments.count, arguments.seed, arguments.jobs, out)
        rows.append(summary(reader, outcomes))
        messages = sorted((dataclasses.asdict(o) for o in outcomes), key=lambda o: o["index"])
        (out / "outcomes.json").write_text(json.dumps(messages, indent=0))
    (arguments.out / "table.json").write_text(json.dumps(rows, indent=1))
    (arguments.out / "table.md").write_text(markdown(rows))
    print(markdown(rows), end="")
    return int(any(row[name] for row in rows for name in OUTCOMES if name not in FINE))


if __name__ == "__main__":
    sys.exit(main())
