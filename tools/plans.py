"""Runs plans in processes within a time, and keeps one line of JSON of each that is done."""

from __future__ import annotations

import concurrent.futures
import json
import multiprocessing
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar


class Plan(Protocol):
    """What is to be done."""

    @property
    def key(self) -> tuple[Any, ...]:
        """Which one it is; rows have the same numbers and words."""


P = TypeVar("P", bound=Plan)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """What is done, of a file; a line that was cut off by a kill is left out."""
    lines = path.read_text().splitlines(keepends=True) if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("\n")]


def carry_out(
    plans: Sequence[P],
    work: Callable[[P], dict[str, Any]],
    out: Path,
    *,
    lanes: Callable[[P], str] = lambda plan: "",
    jobs: int | dict[str, int] = 1,
    prepare: Callable[[], object] | None = None,
    time_limit: float | None = None,
    say: Callable[[dict[str, Any]], str] = lambda row: "",
) -> tuple[list[dict[str, Any]], bool]:
    """Does what is waiting, in the order given; gives all new rows, and whether any failed.

    Args:
      plans: what to do. work: does one, in a process of its own.
      out: rows are added to it as they come.
      lanes: by which name of `jobs` a plan is counted. jobs: processes, or processes by lane.
      prepare: called once in each process. time_limit: s, after which nothing is begun.
      say: of a new row, for people.
    """
    began, rows, failed = time.monotonic(), [], False
    room = {"": jobs} if isinstance(jobs, int) else dict(jobs)
    waiting, running = list(plans), {}
    out.parent.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(sum(room.values()), context, prepare) as pool:
        while waiting or running:
            late = time_limit is not None and time.monotonic() - began > time_limit
            for plan in () if late else tuple(waiting):
                if room[lanes(plan)]:
                    room[lanes(plan)] -= 1
                    waiting.remove(plan)
                    running[pool.submit(work, plan)] = plan
            if not running:
                break
            done, _ = concurrent.futures.wait(
                running, return_when=concurrent.futures.FIRST_COMPLETED
            )
            for future in done:
                plan = running.pop(future)
                room[lanes(plan)] += 1
                if (error := future.exception()) is not None:
                    print(f"{plan.key}: {type(error).__name__}: {error}", flush=True)
                    failed = True
                    continue
                rows.append(future.result())
                with out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
                print(*plan.key, say(rows[-1]), f"{rows[-1].get('seconds', 0)} s", flush=True)
    return rows, failed


def left(plans: Iterable[P], done: Iterable[tuple[Any, ...]]) -> list[P]:
    """Plans whose keys are not among those that are done."""
    known = set(done)
    return [plan for plan in plans if plan.key not in known]
