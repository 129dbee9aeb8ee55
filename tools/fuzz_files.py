"""Feeds damaged files of one kind to what reads them and counts how they are taken.

Usage:
  python tools/fuzz_files.py KIND [--count 3000] [--seed 0] --out build/fuzz/KIND.json

Small files of the kind are written by OrbiSim itself and damaged: bytes (flipped, deleted, doubled,
cut off, random) and what the format means (links, external and virtual storage, ranks, types, NaN,
infinity, 1e300, absurd counts, deep nesting, missing attributes). `KINDS` in `fuzz_kinds.py` has
the kinds. Cases run in child processes with limits. What is not "read" or "refused" (an error of
OrbiSim that says that the input is wrong, in one line) is a fault, and so are more than 5 s of
processor time and more than 2 GB of memory; the input is saved beside OUT. The same seed gives the
same inputs.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import dataclasses
import json
import os
import random
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

MAX_SECONDS = 5.0
MAX_BYTES = 2 * 2**30
_MOST_SECONDS = 10
"""Of the processor, after which a case is ended."""
_MOST_BYTES = 6 * 2**30
"""Of address space beyond that of the process at its start."""
_HANG_SECONDS = 120.0
FINE = ("read", "refused")
OUTCOMES = (
    *FINE,
    "unforeseen",
    "exit 1",
    "other exception",
    "crash",
    "hang",
    "over 5 s",
    "over 2 GB",
    "several lines",
)


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of one input: which, how, what was said; s of the processor, bytes at most."""

    index: int
    outcome: str
    message: str = ""
    seconds: float = 0.0
    peak: int = 0


# ---- in the child ------------------------------------------------------------------------------


def make_case(kind: Any, pristine: Path, seed: int, index: int, folder: Path) -> Path:
    """Writes damaged input number `index`; returns its path."""
    rng = random.Random(f"{seed}/{index}")
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(pristine, folder)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        try:
            (kind.damage if rng.random() < 0.65 else kind.damage_bytes)(folder, rng)
        except Exception:  # what is broken already cannot be opened to be damaged further
            kind.damage_bytes(folder, rng)
    return folder


def judge(kind: Any, folder: Path, index: int, most_bytes: float = MAX_BYTES) -> Outcome:
    """Reads an input, and says how that went; `most_bytes` are of the whole process."""
    from orbisim.errors import OrbiSimError
    from orbisim.files.guard import FAILED

    before = _used()
    _reset_peak()
    outcome, message = "read", ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind.read(folder)
    except OrbiSimError as error:
        outcome, message = "refused", str(error)
        if error.exit_status != 2:
            outcome = "exit 1"
        elif len(message.splitlines()) != 1:
            outcome = "several lines"
        elif FAILED in message:
            outcome = "unforeseen"
    except BaseException as error:
        outcome, message = "other exception", f"{type(error).__name__}: {error}"
    seconds, peak = _used() - before, _peak()
    if outcome in FINE and seconds > MAX_SECONDS:
        outcome = "over 5 s"
    elif outcome in FINE and peak > most_bytes:
        outcome = "over 2 GB"
    return Outcome(index, outcome, message, seconds, peak)


def work(name: str, seed: int, indices: range, scratch: Path, pipe: int) -> None:
    """Runs cases, and writes a line before and after each."""
    from fuzz_kinds import KINDS

    kind, pristine = KINDS[name], scratch / "pristine"
    if not pristine.exists():
        pristine.mkdir()
        kind.make(pristine)
    kind.read(pristine)  # loads what is loaded once, and shows that there is something to damage
    room = _status("VmSize") + _MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (room, room))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with os.fdopen(pipe, "w") as told:
        for index in indices:
            resource.setrlimit(resource.RLIMIT_CPU, (resource.RLIM_INFINITY,) * 2)
            folder = make_case(kind, pristine, seed, index, scratch / "case")
            print(json.dumps({"begin": index}), file=told, flush=True)
            own = resource.getrusage(resource.RUSAGE_SELF)
            soft = int(own.ru_utime + own.ru_stime) + _MOST_SECONDS
            resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.RLIM_INFINITY))
            done = judge(kind, folder, index)
            print(json.dumps(dataclasses.asdict(done)), file=told, flush=True)


def _used() -> float:
    both = (resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


def _reset_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> int:
    """Resident memory at most since `_reset_peak`; of children, since the start."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    return max(_status("VmHWM"), children)


def _status(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{name}:"))


# ---- in the parent -----------------------------------------------------------------------------


def run(name: str, indices: range, seed: int, failures: Path) -> Iterator[Outcome]:
    """Runs the cases of those numbers, in turn; saves those that were not taken well."""
    start = indices.start
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        scratch = Path(folder)
        while start < indices.stop:
            for outcome in _batch(name, seed, range(start, indices.stop), scratch):
                start = outcome.index + 1
                if outcome.outcome not in FINE:
                    _keep(name, seed, outcome, scratch, failures)
                yield outcome


def _batch(name: str, seed: int, indices: range, scratch: Path) -> Iterator[Outcome]:
    """Cases in one child, to the end or to the first that the child does not outlive."""
    listen, tell = os.pipe()
    bounds = [str(indices.start), str(indices.stop)]
    command = [sys.executable, __file__, name, "--seed", str(seed), "--worker", *bounds]
    child = subprocess.Popen(
        [*command, "--scratch", str(scratch), "--pipe", str(tell)],
        pass_fds=[tell], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(tell)
    begun, hung, peak = -1, False, 0
    try:
        with os.fdopen(listen) as told:
            while True:
                if not select.select([told], [], [], _HANG_SECONDS)[0]:
                    hung = True
                    child.kill()
                line = told.readline()
                if not line:
                    break
                found = json.loads(line)
                if "begin" in found:
                    begun = found["begin"]
                    continue
                begun = -1
                yield Outcome(**found)
                peak = max(peak, found["peak"])
                if peak > MAX_BYTES:  # that of children stays: start afresh
                    child.kill()
                    break
    except GeneratorExit:  # no more are wanted
        child.kill()
        raise
    finally:
        child.wait()
    if begun >= 0:
        died = f"exit status {child.returncode}"
        late = child.returncode == -signal.SIGXCPU
        yield Outcome(begun, "hang" if hung else "over 5 s" if late else "crash", died)
    elif child.returncode not in (0, -signal.SIGKILL):
        raise SystemExit(f"{name}: the child ended with {child.returncode} outside of a case")


def _keep(name: str, seed: int, outcome: Outcome, scratch: Path, failures: Path) -> None:
    """Makes the input again, as the child is at the next one by now."""
    from fuzz_kinds import KINDS

    target = failures / str(outcome.index)
    target.parent.mkdir(parents=True, exist_ok=True)
    make_case(KINDS[name], scratch / "pristine", seed, outcome.index, target)
    (target / "outcome.txt").write_text(f"{outcome.outcome}\n{outcome.message}\n")
    print(f"{outcome.index}: {outcome.outcome}: {outcome.message[:300]}", file=sys.stderr)


def summary(name: str, seed: int, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Counts, and the dearest inputs."""
    counts = collections.Counter(outcome.outcome for outcome in outcomes)
    return {
        "kind": name,
        "seed": seed,
        "inputs": len(outcomes),
        **{outcome: counts[outcome] for outcome in OUTCOMES},
        "most_processor_s": round(max((o.seconds for o in outcomes), default=0.0), 2),
        "most_memory_mb": round(max((o.peak for o in outcomes), default=0) / 2**20),
        "faults": [dataclasses.asdict(o) for o in outcomes if o.outcome not in FINE],
    }


def main() -> int:
    """Runs the program; the exit status is 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind")
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--worker", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--scratch", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--pipe", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        work(given.kind, given.seed, range(*given.worker), given.scratch, given.pipe)
        return 0
    if given.out is None:
        parser.error("--out is needed")
    started = time.monotonic()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    failures = given.out.with_suffix("")
    outcomes = list(run(given.kind, range(given.count), given.seed, failures))
    found = summary(given.kind, given.seed, outcomes)
    given.out.write_text(json.dumps(found, indent=1) + "\n")
    shown = {key: value for key, value in found.items() if key != "faults"}
    print(json.dumps(shown), f"in {time.monotonic() - started:.0f} s")
    return int(any(outcome.outcome not in FINE for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
