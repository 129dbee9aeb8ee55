"""Blind trials of the diagnosis.

    python tools/blind_trials.py generate --out trials --workers 16
    python tools/blind_trials.py run --trials trials --out results.jsonl --workers 15
    python tools/blind_trials.py score --trials trials --results results.jsonl --out scores

`generate` writes `trials/<name>/` (a declared scene and recordings: all that `run` opens) and,
apart from them, `truth/`. Names of trials say nothing. `run` lets the diagnosis and its peer,
mujoco.sysid with four parameters a joint, work on each trial, one after the other. Both commands go
on where they were stopped. `--sample` takes a fixed few.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "backends"))

import from_source
from blind.running import TOOLS, run_all, run_one

KINDS = ("single", "pair", "none", "outside")


def generate(args: argparse.Namespace) -> int:
    from_source.register("mujoco")
    from blind.grid import SAMPLE, every
    from blind.making import make, motion_of
    from blind.scenes import RIGS

    out = Path(args.out)
    if args.sample:
        jobs = [(wish, f"s{i:02d}") for i, wish in enumerate(SAMPLE)]
    else:
        wishes = every({name: motion_of(name) for name in RIGS}, args.seed)
        jobs = [(wish, f"t{i:04d}") for i, wish in enumerate(wishes)]
    if args.scenes:
        unknown = sorted(set(args.scenes) - set(RIGS))
        if unknown:
            print(f"no scene {unknown[0]!r}; there are {', '.join(RIGS)}", file=sys.stderr)
            return 2
        jobs = [(wish, name) for wish, name in jobs if wish.scene in args.scenes]
    if args.kinds:
        jobs = [(wish, name) for wish, name in jobs if wish.kind in args.kinds]
    if args.only:
        unknown = sorted(set(args.only) - {name for _, name in jobs})
        if unknown:
            print(f"no trial {unknown[0]!r} among the {len(jobs)} chosen", file=sys.stderr)
            return 2
        jobs = [(wish, name) for wish, name in jobs if name in args.only]
    if args.limit:
        jobs = jobs[: args.limit]
    entries: list[dict[str, Any]] = []
    with ProcessPoolExecutor(args.workers, initializer=single_threaded) as pool:
        waiting = [pool.submit(make, wish, name, out) for wish, name in jobs]
        for done in as_completed(waiting):
            try:
                entries.append(done.result())
            except BrokenProcessPool:
                print("a worker has died: run this again, it goes on from here", file=sys.stderr)
                return 1
            if len(entries) % 20 == 0 or len(entries) == len(jobs):
                print(f"{len(entries)} of {len(jobs)}", file=sys.stderr, flush=True)
    entries.sort(key=lambda entry: entry["trial"])
    (out / "truth" / "index.json").write_text(json.dumps(entries, indent=1))
    skipped = [entry for entry in entries if "skipped" in entry]
    kinds = Counter(entry["wish"]["kind"] for entry in entries if "skipped" not in entry)
    seconds = sum(entry.get("seconds", 0.0) for entry in entries)
    print(
        f"{len(entries) - len(skipped)} trials ({dict(kinds)}), {len(skipped)} left out as nothing "
        f"shows, {seconds:.0f} s of work"
    )
    return 0


def single_threaded() -> None:
    """Keeps a worker to one core: libraries ask for the number of cores to start threads."""
    os.environ["OMP_NUM_THREADS"] = "1"
    if hasattr(os, "sched_setaffinity"):
        own = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {own[os.getpid() % len(own)]})
    from_source.register("mujoco")


def one(args: argparse.Namespace) -> int:
    """A single trial, in a process of its own (used by `run`)."""
    from_source.register("mujoco")
    return run_one(Path(args.folder), args.tool, args.seconds, args.patience)


def score(args: argparse.Namespace) -> int:
    from_source.register("mujoco")
    from blind.scoring import write_scores

    return write_scores(Path(args.trials), Path(args.results), Path(args.out))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("generate", help="write trials and the truth about them")
    making.add_argument("--out", required=True)
    making.add_argument("--seed", type=int, default=2026)
    making.add_argument("--workers", type=int, default=1)
    making.add_argument("--limit", type=int, default=0)
    making.add_argument("--scenes", nargs="+", default=[], help="only trials of these")
    making.add_argument("--kinds", nargs="+", default=[], choices=KINDS, help="only these")
    making.add_argument("--only", nargs="+", default=[], help="names of trials")
    making.add_argument("--sample", action="store_true", help="only the fixed few")
    making.set_defaults(work=generate)
    running = commands.add_parser("run", help="diagnose trials, and let the peer fit them")
    running.add_argument("--trials", required=True, help="what `generate` wrote")
    running.add_argument("--out", required=True, help="one JSON line for each trial and tool")
    running.add_argument("--workers", type=int, default=1)
    running.add_argument("--tools", nargs="+", choices=TOOLS, default=list(TOOLS))
    running.add_argument("--only", nargs="+", default=[], help="names of trials or scenes")
    running.add_argument("--limit", type=int, default=0, help="so many trials, in their order")
    running.add_argument(
        "--first", nargs="+", default=[], help="scenes whose trials, which take longest, come first"
    )
    running.add_argument("--sample", action="store_true", help="only the fixed few")
    running.add_argument("--timeout", type=float, default=900.0, help="s, for each diagnosis")
    running.add_argument("--patience", type=float, help="s, of each diagnosis; else its default")
    running.add_argument("--peer-timeout", type=float, default=300.0, help="s, for each peer's fit")
    running.add_argument(
        "--time-limit", type=float, default=0.0, help="s, for all; what is cut off is left undone"
    )
    running.add_argument("--again", action="store_true", help="also what has failed")
    running.set_defaults(work=run_all)
    single = commands.add_parser("one")
    single.add_argument("folder")
    single.add_argument("--tool", choices=TOOLS, default=TOOLS[0])
    single.add_argument("--seconds", type=float, default=300.0)
    single.add_argument("--patience", type=float)
    single.set_defaults(work=one)
    scoring = commands.add_parser("score", help="open the truth and count")
    scoring.add_argument("--trials", required=True)
    scoring.add_argument("--results", required=True)
    scoring.add_argument("--out", required=True)
    scoring.set_defaults(work=score)
    args = parser.parse_args(argv)
    return int(args.work(args))


if __name__ == "__main__":
    raise SystemExit(main())
