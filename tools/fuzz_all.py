"""Runs `fuzz_files` for many kinds on many processors within a time limit, and goes on later.

Usage:
  python tools/fuzz_all.py [KIND ...] --processes 16 --seconds 540 --out build/fuzz/all.json

Without kinds, all of them. The inputs of a kind are cut into spans of `--span`; processes take them
in turn, a span of each kind after the other. What is done when the time is up stands in OUT (ranges
of inputs, counts, faults) and is left out when the same command runs again; damaged inputs that
were not taken well are in the folder of OUT's name without suffix.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import multiprocessing
import os
import queue
import sys
import time
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from fuzz_files import FINE, OUTCOMES, Outcome, run

Span = tuple[str, int, int]
"""A kind, the first of its inputs, and the one after the last."""


def spans(kinds: Sequence[str], count: int, span: int, done: dict[str, Any]) -> list[Span]:
    """What is left to do: a span of each kind in turn."""
    rows = []
    for name in kinds:
        ranges = done.get(name, {}).get("ranges", [])
        known = {i for first, stop in ranges for i in range(first, stop)}
        left = [i for i in range(count) if i not in known]
        rows.append([(name, *bounds) for bounds in _pieces(left, span)])
    return [one for several in zip_longest(*rows) for one in several if one is not None]


def _pieces(numbers: Iterable[int], longest: int) -> list[tuple[int, int]]:
    """The numbers as ranges."""
    found: list[tuple[int, int]] = []
    for number in numbers:
        if found and found[-1][1] == number and number - found[-1][0] < longest:
            found[-1] = (found[-1][0], number + 1)
        else:
            found.append((number, number + 1))
    return found


def _extend(ranges: list[list[int]], number: int) -> None:
    """Adds a number that comes right after a range, mostly."""
    for bounds in ranges:
        if bounds[1] == number:
            bounds[1] += 1
            return
    ranges.append([number, number + 1])


def work(todo: Any, told: Any, seed: int, until: float, failures: Path, niced: int) -> None:
    """Takes spans until there are none, or the time is up; tells outcomes as they come."""
    os.nice(niced)
    while time.time() < until:
        taken = todo.get()
        if taken is None:
            return
        name, first, stop = taken
        try:
            for outcome in run(name, range(first, stop), seed, failures / name):
                told.put((name, dataclasses.asdict(outcome)))
                if time.time() > until:
                    return
        except SystemExit as error:  # the child failed outside of a case
            told.put((name, str(error)))


def gather(found: dict[str, Any], name: str, outcome: dict[str, Any] | str) -> None:
    """Adds an outcome to what is known of its kind."""
    row = found.setdefault(
        name, {"inputs": 0, **dict.fromkeys(OUTCOMES, 0), "processor_s": 0.0,
               "most_processor_s": 0.0, "most_memory_mb": 0, "ranges": [], "faults": []},
    )  # fmt: skip
    if isinstance(outcome, str):
        row["faults"].append(outcome)
        return
    one = Outcome(**outcome)
    row["inputs"] += 1
    row[one.outcome] += 1
    row["processor_s"] = round(row["processor_s"] + one.seconds, 2)
    row["most_processor_s"] = max(row["most_processor_s"], round(one.seconds, 2))
    row["most_memory_mb"] = max(row["most_memory_mb"], round(one.peak / 2**20))
    if one.outcome not in FINE:
        row["faults"].append(outcome)
    _extend(row["ranges"], one.index)


def main() -> int:
    """Runs the program; the exit status is 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*")
    parser.add_argument("--count", type=int, default=3000, help="inputs of each kind")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--span", type=int, default=100)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--nice", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    from fuzz_kinds import KINDS

    began = time.time()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    found = json.loads(given.out.read_text()) if given.out.exists() else {}
    rest = spans(given.kinds or list(KINDS), given.count, given.span, found)
    todo, told = multiprocessing.Queue(), multiprocessing.Queue()
    for one in [*rest, *[None] * given.processes]:
        todo.put(one)
    todo.cancel_join_thread()
    failures, until = given.out.with_suffix(""), began + given.seconds
    settled = (todo, told, given.seed, until, failures, given.nice)
    processes = [multiprocessing.Process(target=work, args=settled) for _ in range(given.processes)]
    for process in processes:
        process.start()
    written = 0.0
    while any(process.is_alive() for process in processes) or not told.empty():
        with contextlib.suppress(queue.Empty):
            gather(found, *told.get(timeout=1))
        if time.time() - written > 10:
            given.out.write_text(json.dumps(found) + "\n")
            written = time.time()
    given.out.write_text(json.dumps(found) + "\n")
    for name, row in found.items():
        shown = {k: v for k, v in row.items() if v and k not in ("faults", "ranges")}
        print(name, json.dumps(shown), f"{len(row['faults'])} faults")
        for fault in row["faults"]:
            print("  ", json.dumps(fault)[:400])
    print(f"{time.time() - began:.0f} s with {given.processes} processes")
    return int(any(row["faults"] for row in found.values()))


if __name__ == "__main__":
    sys.exit(main())
