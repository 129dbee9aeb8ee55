"""Runs a tool on trials, each in a process of its own, and keeps one JSON line for each."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
import traceback
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import Queue
from typing import Any

ENTRY = Path(__file__).resolve().parent.parent / "blind_trials.py"


def names_of(args: argparse.Namespace) -> list[str]:
    """Names of the trials that are asked for and not yet done."""
    folder = Path(args.trials) / "trials"
    names = sorted(path.name for path in folder.iterdir() if (path / "scene.xml").exists())
    if args.sample:
        names = [name for name in names if name.startswith("s")]
    if args.only:
        names = [n for n in names if n in args.only or _scene_of(folder / n) in args.only]
    done = {entry["trial"] for entry in read_lines(Path(args.out)) if not _again(args, entry)}
    names = [name for name in names if name not in done]
    return names[: args.limit] if args.limit else names


def _again(args: argparse.Namespace, entry: dict[str, Any]) -> bool:
    return bool(args.again and entry.get("failure"))


def _scene_of(folder: Path) -> str:
    text = (folder / "scene.xml").read_text()
    return text.partition('model="')[2].partition('"')[0]


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Entries of a file of JSON lines; the last one of a trial counts; none if it is missing."""
    if not path.exists():
        return []
    lines = [json.loads(line) for line in path.read_text().splitlines() if line.strip()]
    return list({entry["trial"]: entry for entry in lines}.values())


def run_all(args: argparse.Namespace, tool: str) -> int:
    """Runs a tool on all trials that are asked for; appends to the file of results."""
    names, out = names_of(args), Path(args.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(args.trials) / "trials"
    failed, started = 0, time.perf_counter()
    cores: Queue[int] = Queue()
    for core in range(args.workers):
        cores.put(core)
    with ThreadPoolExecutor(args.workers) as pool, out.open("a") as stream:
        waiting = [pool.submit(_in_process, folder / n, tool, args.timeout, cores) for n in names]
        for number, done in enumerate(as_completed(waiting), 1):
            entry = done.result()
            stream.write(json.dumps(entry) + "\n")
            stream.flush()
            failed += entry["failure"] is not None
            what = entry["failure"] or _brief(entry)
            spent = time.perf_counter() - started
            print(
                f"[{number}/{len(names)}, {spent:.0f} s] {entry['trial']} {entry['scene']} "
                f"{entry['seconds']:.1f} s: {what}",
                file=sys.stderr,
                flush=True,
            )
    print(f"{len(names)} trials, {failed} failed, {time.perf_counter() - started:.0f} s")
    return 0


def _brief(entry: dict[str, Any]) -> str:
    report = entry["report"]
    effects = ", ".join(f"{e['effect']}({e['target']})" for e in report.get("effects", []))
    error = report["error"]["held_out"]
    return f"{report['verdict']} {effects} {error['before']:.3g} -> {error['after']:.3g}"


def _in_process(folder: Path, tool: str, timeout: float, cores: Queue[int]) -> dict[str, Any]:
    core = cores.get()
    try:
        return _on_core(folder, tool, timeout, core)
    finally:
        cores.put(core)


def _on_core(folder: Path, tool: str, timeout: float, core: int) -> dict[str, Any]:
    command = [sys.executable, str(ENTRY), "one", str(folder), "--tool", tool, "--core", str(core)]
    entry = {"trial": folder.name, "scene": _scene_of(folder), "failure": None, "report": None}
    started = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        entry["failure"] = f"took more than {timeout:g} s"
    else:
        try:
            answer = json.loads(done.stdout.strip().splitlines()[-1])
            entry |= {"report": answer.get("report"), "failure": answer.get("failure")}
        except (IndexError, ValueError):
            entry["failure"] = f"exit status {done.returncode}: {done.stderr.strip()[-2000:]}"
    return entry | {"seconds": round(time.perf_counter() - started, 2)}


def run_one(folder: Path, tool: str) -> int:
    """Runs a tool on one trial and prints a JSON object. Only this folder is read."""
    try:
        report = _diagnosed(folder) if tool == "diagnose" else _fitted(folder)
        print(json.dumps({"report": report, "failure": None}))
    except Exception as error:
        lines = traceback.format_exc().splitlines()
        print(json.dumps({"report": None, "failure": f"{error!r}", "trace": lines[-12:]}))
    return 0


def recordings_of(folder: Path, part: str) -> list[Path]:
    """The files of the recordings to fit to (`fit`) or held out (`held`)."""
    return sorted(folder.glob(f"{part}_*.npz"))


KEPT = ("verdict", "sentence", "effects", "retuned", "alternatives", "error", "residual", "noise")


def _diagnosed(folder: Path) -> dict[str, Any]:
    import orbisim

    found = orbisim.diagnose(
        folder / "scene.xml",
        recordings_of(folder, "fit"),
        held_out=recordings_of(folder, "held"),
        out=None,
        progress=False,
    ).to_json()
    return {key: found[key] for key in KEPT if key in found}


def _fitted(folder: Path) -> dict[str, Any]:
    from blind.peer import fit

    return fit(folder / "scene.xml", recordings_of(folder, "fit"), recordings_of(folder, "held"))
