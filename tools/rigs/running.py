"""Runs tools on trials, each in a process of its own, and keeps one JSON line for each.

What has a line is not run again, so that a run can be stopped and continued.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from processes import answer_of, read_lines, with_own_cores

ENTRY = Path(__file__).resolve().parent.parent / "rig_trials.py"

AROUND = 60.0
"""What a process may take besides its work: to start, to read and to score, s."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A tool on a trial, how long it may work, s, and further words for `one`."""

    trial: str
    tool: str
    seconds: float
    words: tuple[str, ...] = ()


def jobs_of(args: argparse.Namespace) -> list[Job]:
    """What is asked for and not yet done: all tools on a trial before the next trial.

    Raises:
      SystemExit: a trial that is asked for is not there.
    """
    folder, (index, count) = Path(args.trials) / "trials", args.shard
    names = sorted(path.name for path in folder.iterdir() if any(path.glob("scene.*")))
    unknown = sorted(set(args.only) - set(names))
    if unknown:
        raise SystemExit(f"no trial {unknown[0]!r} among the {len(names)} of {folder}")
    names = [n for n in names if not args.only or n in args.only]
    names = [n for n in names if int(n.lstrip("r")) % count == index]
    names = names[: args.limit] if args.limit else names
    done = {
        (entry["trial"], entry["tool"])
        for entry in read_lines(Path(args.out))
        if not (args.again and entry["failure"])
    }
    words = ("--seed", str(args.seed), *(["--half"] if args.half else []))
    every = [
        Job(name, tool, args.timeout, words)
        if tool == "diagnose"
        else Job(name, tool, args.peer_timeout)
        for name in names
        for tool in args.tools
    ]
    return [job for job in every if (job.trial, job.tool) not in done]


def run_all(args: argparse.Namespace) -> int:
    """Does all jobs that are asked for; appends to the file of results."""
    jobs, out = jobs_of(args), Path(args.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    started, failed, done = time.perf_counter(), 0, 0
    until = started + args.time_limit if args.time_limit else float("inf")
    folder = Path(args.trials) / "trials"
    with with_own_cores(args.workers) as pool, out.open("a") as stream:
        stream.write("\n" if jobs else "")  # ends a line that a killed run has left unfinished
        waiting = [pool.submit(entry_of, folder / job.trial, job, until) for job in jobs]
        for finished in as_completed(waiting):
            entry = finished.result()
            if entry is None:
                continue
            stream.write(json.dumps(entry) + "\n")
            stream.flush()
            done, failed = done + 1, failed + (entry["failure"] is not None)
            spent = time.perf_counter() - started
            where = f"[{done}/{len(jobs)}, {spent:.0f} s]"
            print(where, _brief(entry), file=sys.stderr, flush=True)
    spent = time.perf_counter() - started
    print(f"{done} of {len(jobs)} done, {failed} of these failed, {spent:.0f} s")
    return 0


def _brief(entry: dict[str, Any]) -> str:
    head = f"{entry['trial']} {entry['tool']} {entry['seconds']:.0f} s:"
    if entry["failure"]:
        return f"{head} {entry['failure'][:200]}"
    report = entry["report"]
    effects = ", ".join(f"{e['effect']}({e['target']})" for e in report.get("effects", []))
    error = report["error"]["held_out"]
    return f"{head} {report['verdict']} {effects} {error['before']} -> {error['after']}"


def entry_of(folder: Path, job: Job, until: float) -> dict[str, Any] | None:
    """The line of a job; None, without beginning, if it might outlast the time for the whole run:
    what is cut off at the end would be what takes long, and shares would be of the easy ones."""
    entry = {"trial": job.trial, "tool": job.tool, "failure": None, "report": None}
    started = time.perf_counter()
    limit = job.seconds + AROUND
    if limit > until - started:
        return None
    command = [sys.executable, str(ENTRY), "one", str(folder), "--tool", job.tool]
    try:
        answer = answer_of([*command, "--seconds", str(job.seconds), *job.words], limit)
        entry |= {"report": answer["report"], "failure": answer["failure"]}
    except (TimeoutError, ValueError) as error:
        entry["failure"] = str(error)
    return entry | {"seconds": round(time.perf_counter() - started, 1)}
