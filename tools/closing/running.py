"""Runs tools on measured sets, each in a process of its own, and keeps a file for each result.

What has a result is not run again, so that a run can be stopped and continued.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from processes import answer_of, with_own_cores

ENTRY = Path(__file__).resolve().parent.parent / "closing_the_loop.py"

_AROUND = 60.0
"""What a process may take besides its fit: to start, to read, to score, s."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A tool on a set, with the patience of the fit, s."""

    name: str
    tool: str
    patience: float

    @property
    def limit(self) -> float:
        """After which the process is ended, s."""
        return 1.1 * self.patience + _AROUND


def path_of(out: Path, name: str, tool: str) -> Path:
    """Of a result."""
    return out / "results" / f"{name}.{tool}.json"


def results_of(out: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """All results, by set and tool."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for path in sorted((out / "results").glob("*.json")):
        name, _, tool = path.stem.partition(".")
        found.setdefault(name, {})[tool] = json.loads(path.read_text())
    return found


def run_all(
    jobs: Sequence[Job], data: Path, out: Path, workers: int, time_limit: float
) -> Iterator[tuple[Job, dict[str, Any]]]:
    """Does what has no result, several at a time; gives each as it ends.

    Args:
      time_limit: for all, s; 0 for none. What it ends has no result and is run next time.
    """
    until = time.perf_counter() + time_limit if time_limit else float("inf")
    (out / "results").mkdir(parents=True, exist_ok=True)
    todo = [job for job in jobs if not path_of(out, job.name, job.tool).exists()]
    with with_own_cores(workers) as pool:
        waiting = {pool.submit(_result, job, data, out, until): job for job in todo}
        for done in as_completed(waiting):
            job, result = waiting[done], done.result()
            if result is not None:
                path = path_of(out, job.name, job.tool)
                path.with_suffix(".part").write_text(json.dumps(result, indent=1))
                path.with_suffix(".part").replace(path)
                yield job, result


def _result(job: Job, data: Path, out: Path, until: float) -> dict[str, Any] | None:
    limit = min(job.limit, until - time.perf_counter())
    if limit <= 0:
        return None
    command = [sys.executable, str(ENTRY), str(data), str(out), "--set", job.name]
    try:
        return answer_of([*command, "--only", job.tool, "--patience", str(job.patience)], limit)
    except TimeoutError:
        if limit < job.limit:
            return None
        return {"failure": f"no answer after {limit:.0f} s", "seconds": limit}
    except ValueError as error:
        return {"failure": str(error)}
