"""Kills commands in the middle of their work, and looks at what they leave.

Usage:
  python tools/kill_commands.py --trials 10 --out build/kills.json [COMMAND ...]

Every trial starts a command of its own (`sim`, `compare`, `diagnose`, `collect`, `train`) and sends
SIGKILL or SIGTERM after a random part of the time that it takes when it is let be. A trial is bad
if a process is left, if a file under its final name is not whole, or if the command, run again
(with --resume for `train`), does not end well or, for `collect` and `train`, not with the bytes of
an undisturbed run. Where file systems may be mounted, each command also runs once on a full disk
and once in a read-only folder: it must end with an error of one line, and leave no half file.
"""

from __future__ import annotations

import argparse
import collections
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
ARM = ROOT / "mjcf_assets" / "arm2"
_PROGRAM = (sys.executable, "-c", "from orbisim.cli.main import main; main()")
_MARK = "ORBISIM_KILL_TRIAL"
_GRACE = 5.0
"""s after which processes of a command that was killed must have ended."""
_SMALL = "size=64k"

COMMANDS = ("sim", "compare", "diagnose", "collect", "train")
_SAME_BYTES = {"collect": "a.h5", "train": "model.safetensors"}


def arguments(command: str, out: Path, data: Path, again: bool = False) -> list[str]:
    """The command line of a trial; `again` after it was killed."""
    scene = str(ARM / "scene.xml")
    if command == "sim":
        return ["sim", scene, "--duration", "60", "--controls", "random", "--out", str(out)]
    if command == "compare":
        sides = ["--a", "mujoco", "--b", "mujoco", "--episodes", "8", "--no-video"]
        return ["compare", scene, *sides, "--out", str(out)]
    if command == "diagnose":
        runs = sorted(str(path) for path in (ARM / "example").glob("*.npz"))
        few = ["--effect", "coulomb_friction", "--no-retune", "--patience", "5"]
        return ["diagnose", scene, *runs, *few, "--out", str(out)]
    if command == "collect":
        return ["collect", "ball", "--episodes", "60", "--workers", "2", "--out", str(out / "a.h5")]
    small = [f"--set=model.{k}={v}" for k, v in {"width": 16, "layers": 1, "heads": 1}.items()]
    budget = ["--set=train.stages=1x1x64", "--steps", "60", "--save-every", "0.2"]
    resume = ["--resume"] if again and (out / "training.safetensors").exists() else []
    return [
        "train", "dynamics", str(data), *small, *budget, *resume, "--device", "cpu",
        "--out", str(out),
    ]  # fmt: skip


def start(words: Sequence[str], mark: str) -> subprocess.Popen[str]:
    """Starts a command, recognizable by a variable of its environment."""
    return subprocess.Popen(
        [*_PROGRAM, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env={**os.environ, _MARK: mark}, cwd=ROOT,
    )  # fmt: skip


def left(mark: str) -> list[int]:
    """Processes of a command that live."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            known = folder.name.isdigit() and f"{_MARK}={mark}" in (
                (folder / "environ").read_bytes().decode(errors="replace").split("\0")
            )
            if known and "\nState:\tZ" not in (folder / "status").read_text():
                found.append(int(folder.name))
        except OSError:  # gone meanwhile
            continue
    return found


def half_files(folder: Path) -> list[str]:
    """Files under their final names that are not whole."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    final = [p for p in paths if not any(_unfinished(part) for part in p.relative_to(folder).parts)]
    return [str(path.relative_to(folder)) for path in final if not _whole(path)]


def _unfinished(part: str) -> bool:
    return part.startswith(".") or part.endswith(".partial")


def _whole(path: Path) -> bool:
    from safetensors import safe_open

    from orbisim.tasks.dataset import EpisodeFile

    try:
        if path.suffix == ".npz":
            with np.load(path) as file:
                return all(file[name] is not None for name in file.files)
        if path.suffix == ".json":
            return isinstance(json.loads(path.read_text()), dict)
        if path.suffix == ".html":
            return path.read_text().rstrip().endswith("</html>")
        if path.suffix == ".safetensors":
            with safe_open(path, "np") as tensors:
                return bool(tensors.keys())
        if path.suffix == ".h5":
            with EpisodeFile(path) as episodes:
                return len(episodes) > 0
        return path.suffix == ".jsonl" or path.stat().st_size > 0
    except Exception:
        return False


def undisturbed(command: str, out: Path, data: Path) -> tuple[float, str]:
    """Seconds that a command takes, and the hash of its result."""
    began = time.monotonic()
    child = start(arguments(command, out, data), "undisturbed")
    _, said = child.communicate()
    if child.returncode:
        raise SystemExit(f"{command} fails undisturbed: {said}")
    return time.monotonic() - began, _hash(command, out)


def _hash(command: str, out: Path) -> str:
    if command not in _SAME_BYTES:
        return ""
    return hashlib.sha256((out / _SAME_BYTES[command]).read_bytes()).hexdigest()


def trial(command: str, how: signal.Signals, after: float, data: Path, expected: str) -> list[str]:
    """Kills one command; returns what is bad about what is left."""
    mark, bad = f"{os.getpid()}-{random.random()}", []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out")
        out.mkdir()
        child = start(arguments(command, out, data), mark)
        time.sleep(after)
        child.send_signal(how)
        child.communicate()
        deadline = time.monotonic() + _GRACE
        while left(mark) and time.monotonic() < deadline:
            time.sleep(0.05)
        bad += [f"process {pid} is left" for pid in left(mark)]
        bad += [f"{name} is half a file" for name in half_files(out)]
        if command == "collect" and (out / "a.h5").exists():
            return bad  # it had ended; the file must not exist
        if (
            command == "train"
            and (out / "manifest.json").exists()
            and not (out / "training.safetensors").exists()
        ):
            return bad
        again = start(arguments(command, out, data, again=True), mark)
        _, said = again.communicate()
        if again.returncode:
            bad.append(f"run again, it ends with {again.returncode}: {said.strip()[-300:]}")
        elif _hash(command, out) != expected:
            bad.append("run again, the result is another")
    return bad


@contextmanager
def mounted(options: str) -> Iterator[Path]:
    """A temporary file system in memory."""
    with tempfile.TemporaryDirectory() as folder:
        mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder]
        subprocess.run(mount, check=True, capture_output=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", "-l", folder], check=True, capture_output=True)


def cornered(command: str, options: str, data: Path) -> list[str]:
    """What is bad about a command whose output has no place."""
    bad = []
    with mounted(options) as out:
        child = start(arguments(command, out, data), "cornered")
        _, said = child.communicate()
        last = said.strip().splitlines()[-1:] or [""]
        if child.returncode not in (1, 2) or not last[0].startswith("error: "):
            bad.append(f"ends with {child.returncode}: {last[0][:300]}")
        if "a fault in OrbiSim" in said:
            bad.append(last[0][:300])
        bad += [f"{name} is half a file" for name in half_files(out)]
    return bad


def run(command: str, trials: int, seed: int, scratch: Path, mount: bool) -> dict[str, Any]:
    """All trials of a command."""
    data, rng = scratch / "data.h5", random.Random(f"{seed}/{command}")
    if command == "train" and not data.exists():
        made = start(["collect", "ball", "--episodes", "12", "--out", str(data)], "data")
        made.communicate()
    place = scratch / f"{command}-undisturbed"
    place.mkdir()
    duration, expected = undisturbed(command, place, data)
    counts: collections.Counter[str] = collections.Counter()
    faults: list[str] = []
    for number in range(trials):
        how = (signal.SIGKILL, signal.SIGTERM)[number % 2]
        found = trial(command, how, rng.uniform(0.1, 1.0) * duration, data, expected)
        counts[how.name] += 1
        faults += [f"{how.name} {number}: {text}" for text in found]
    for name, options in (("full disk", _SMALL), ("read-only", "ro")) if mount else ():
        counts[name] += 1
        faults += [f"{name}: {text}" for text in cornered(command, options, data)]
    return {"command": command, "undisturbed_s": round(duration, 1), **counts, "faults": faults}


def main() -> int:
    """Runs the program; the exit status is 1 if anything was bad."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commands", nargs="*", default=list(COMMANDS))
    parser.add_argument("--trials", type=int, default=10, help="of each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for command in given.commands:
            mount = hasattr(os, "getuid") and os.getuid() == 0
            rows.append(run(command, given.trials, given.seed, Path(scratch), mount))
            print(json.dumps(rows[-1]), flush=True)
            given.out.write_text(json.dumps(rows, indent=1) + "\n")
    return int(any(row["faults"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
