"""Runs the diagnosis and its peer on trials, each in a process of its own, and keeps one JSON line
for each. What has a line is not run again, so that a run can be stopped and continued.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from processes import answer_of, read_lines, with_own_cores

ENTRY = Path(__file__).resolve().parent.parent / "blind_trials.py"

TOOLS = ("diagnose", "peer")
AROUND = 60.0
"""What the peer's process may take besides the fit: to start, to read and to score, s."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A tool on a trial.

    Attributes:
      seconds: for the process; of the peer, which stops itself, for the fit.
      patience: of the diagnosis, s; its default if None.
    """

    trial: str
    tool: str
    seconds: float
    patience: float | None = None

    @property
    def limit(self) -> float:
        """When the process is ended, s after its start."""
        return self.seconds + AROUND if self.tool == "peer" else self.seconds


def jobs_of(args: argparse.Namespace) -> list[Job]:
    """What is asked for and not yet done: all tools on a trial before the next trial.

    Raises:
      SystemExit: a trial or scene that is asked for is not there.
    """
    folder = Path(args.trials) / "trials"
    names = sorted(path.name for path in folder.iterdir() if (path / "scene.xml").exists())
    if args.sample:
        names = [name for name in names if name.startswith("s")]
    if args.only:
        scenes = {name: _scene_of(folder / name) for name in names}
        unknown = sorted(set(args.only) - {*scenes, *scenes.values()})
        if unknown:
            raise SystemExit(f"no trial or scene {unknown[0]!r} among the {len(names)} of {folder}")
        names = [n for n in names if n in args.only or scenes[n] in args.only]
    names = names[: args.limit] if args.limit else names
    if args.first:
        scenes = {name: _scene_of(folder / name) for name in names}
        names.sort(key=lambda name: scenes[name] not in args.first)
    done = {
        (entry["trial"], entry["tool"])
        for entry in read_lines(Path(args.out))
        if not (args.again and entry["failure"])
    }
    seconds = {"diagnose": args.timeout, "peer": args.peer_timeout}
    every = [Job(name, tool, seconds[tool], args.patience) for name in names for tool in args.tools]
    return [job for job in every if (job.trial, job.tool) not in done]


def _scene_of(folder: Path) -> str:
    text = (folder / "scene.xml").read_text()
    return text.partition('model="')[2].partition('"')[0]


def run_all(args: argparse.Namespace) -> int:
    """Does all jobs that are asked for; appends to the file of results."""
    jobs, out = jobs_of(args), Path(args.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    started, failed, done = time.perf_counter(), 0, 0
    until = started + args.time_limit if args.time_limit else float("inf")
    with with_own_cores(args.workers) as pool, out.open("a") as stream:
        stream.write("\n" if jobs else "")  # ends a line that a killed run has left unfinished
        folder = Path(args.trials) / "trials"
        waiting = [pool.submit(_entry, folder / job.trial, job, until) for job in jobs]
        for finished in as_completed(waiting):
            entry = finished.result()
            if entry is None:
                continue
            stream.write(json.dumps(entry) + "\n")
            stream.flush()
            done, failed = done + 1, failed + (entry["failure"] is not None)
            _tell(entry, f"{done}/{len(jobs)}, {time.perf_counter() - started:.0f} s")
    print(
        f"{done} of {len(jobs)} done, {failed} of these failed, "
        f"{time.perf_counter() - started:.0f} s"
    )
    return 0


def _tell(entry: dict[str, Any], where: str) -> None:
    what = entry["failure"] or _brief(entry)
    words = (entry["trial"], entry["scene"], entry["tool"], f"{entry['seconds']:.1f} s: {what}")
    print(f"[{where}]", *words, file=sys.stderr, flush=True)


def _brief(entry: dict[str, Any]) -> str:
    report = entry["report"]
    effects = ", ".join(f"{e['effect']}({e['target']})" for e in report.get("effects", []))
    error = report["error"]["held_out"]
    before, after = (float("nan") if error[n] is None else error[n] for n in ("before", "after"))
    return f"{report['verdict']} {effects} {before:.3g} -> {after:.3g}"


def _entry(folder: Path, job: Job, until: float) -> dict[str, Any] | None:
    """The entry of a job; None if the time for the whole run was over first."""
    entry = {"trial": job.trial, "tool": job.tool, "scene": _scene_of(folder),
             "failure": None, "report": None}  # fmt: skip
    started = time.perf_counter()
    limit = min(job.limit, until - started)
    if limit <= 0:
        return None
    try:
        answer = answer_of(_command(folder, job), limit)
        entry |= {"report": answer.get("report"), "failure": answer.get("failure")}
    except TimeoutError as error:
        if time.perf_counter() >= until:
            return None
        entry["failure"] = str(error)
    except (OSError, ValueError) as error:  # this machine could not start it, or it crashed
        entry["failure"] = str(error)
    return entry | {"seconds": round(time.perf_counter() - started, 2)}


def _command(folder: Path, job: Job) -> Sequence[str]:
    what = ["--tool", job.tool, "--seconds", str(job.seconds)]
    what += [] if job.patience is None else ["--patience", str(job.patience)]
    return [sys.executable, str(ENTRY), "one", str(folder), *what]


def run_one(folder: Path, tool: str, seconds: float, patience: float | None = None) -> int:
    """Runs a tool on one trial and prints a JSON object. Only this folder is read."""
    try:
        report = _diagnosed(folder, patience) if tool == "diagnose" else _fitted(folder, seconds)
        print(json.dumps({"report": report, "failure": None}))
    except Exception as error:
        lines = traceback.format_exc().splitlines()
        print(json.dumps({"report": None, "failure": f"{error!r}", "trace": lines[-12:]}))
    return 0


def recordings_of(folder: Path, part: str) -> list[Path]:
    """The files of the recordings to fit to (`fit`) or held out (`held`)."""
    return sorted(folder.glob(f"{part}_*.npz"))


KEPT = (
    "verdict", "sentence", "effects", "retuned", "alternatives", "candidates", "error", "residual",
    "noise", "notes", "history_dependent",
)  # fmt: skip


def _diagnosed(folder: Path, patience: float | None) -> dict[str, Any]:
    import orbisim
    from orbisim.diagnosis import Settings

    settings = Settings()
    if patience is not None:
        settings = dataclasses.replace(settings, patience=patience)
    found = orbisim.diagnose(
        folder / "scene.xml",
        recordings_of(folder, "fit"),
        held_out=recordings_of(folder, "held"),
        settings=settings,
        out=None,
        progress=False,
    ).to_json()
    return {key: found[key] for key in KEPT if key in found}


def _fitted(folder: Path, seconds: float) -> dict[str, Any]:
    from blind.peer import fit

    held = recordings_of(folder, "held")
    return fit(folder / "scene.xml", recordings_of(folder, "fit"), held, seconds)
