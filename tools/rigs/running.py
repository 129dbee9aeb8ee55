"""Runs tools on trials, each in a process of its own, and keeps one JSON line for each.

What has a line is not run again, so that a run can be stopped and continued.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

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


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Entries of a file of JSON lines; the last one of a trial and tool counts; none without file.

    A line that a killed run left unfinished is passed over.
    """
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        found[entry["trial"], entry["tool"]] = entry
    return list(found.values())


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
    with ThreadPoolExecutor(args.workers) as pool, out.open("a") as stream:
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
            print(f"[{done}/{len(jobs)}, {spent:.0f} s]", _brief(entry), file=sys.stderr)
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
    process = subprocess.Popen(
        [*command, "--seconds", str(job.seconds), *job.words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )
    try:
        stdout, stderr = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # what it has started, too
        process.communicate()
        entry["failure"] = f"took more than {limit:g} s"
    else:
        try:
            answer = json.loads(stdout.strip().splitlines()[-1])
            entry |= {"report": answer["report"], "failure": answer["failure"]}
        except (IndexError, ValueError, KeyError):
            entry["failure"] = f"exit status {process.returncode}: {stderr.strip()[-1500:]}"
    return entry | {"seconds": round(time.perf_counter() - started, 1)}
