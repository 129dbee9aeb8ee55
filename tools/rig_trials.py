"""Blind trials of the diagnosis on machines and laws that share no code with it.

    python tools/rig_trials.py generate --out rigs --count 300 --workers 16
    python tools/rig_trials.py run --trials rigs --out rigs/results.jsonl --workers 16
    python tools/rig_trials.py score --trials rigs --results rigs/results.jsonl --out scores

`generate` writes `rigs/trials/<name>/` (a declared scene and recordings: all that `run` opens) and,
apart from them, `rigs/truth/`. `run` lets `orbisim diagnose` with its defaults and two peers work
on each trial, each in a process of its own. Both go on where they were stopped, and take every Nth
trial with `--shard I/N`.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "backends")]

TOOLS = ("diagnose", "recipe", "sysid")


def shard_of(text: str) -> tuple[int, int]:
    """`I/N` as numbers, I from 0."""
    index, _, count = text.partition("/")
    try:
        pair = int(index), int(count)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not I/N, as in 0/4") from None
    if not 0 <= pair[0] < pair[1]:
        raise argparse.ArgumentTypeError(f"{text!r}: I is 0 to N - 1")
    return pair


def generate(args: argparse.Namespace) -> int:
    from processes import read_lines
    from rigs.instruments import ARTEFACTS
    from rigs.machines import MACHINES
    from rigs.making import Wish, make, name_of

    unknown = sorted(set(args.machines) - set(MACHINES))
    if unknown:
        print(f"no machine {unknown[0]!r}; there are {', '.join(MACHINES)}", file=sys.stderr)
        return 2
    unknown = sorted(set(args.artefact) - {*ARTEFACTS, "none", "each"})
    if unknown:
        known = ", ".join((*ARTEFACTS, "none", "each"))
        print(f"no artefact {unknown[0]!r}; there are {known}", file=sys.stderr)
        return 2
    if len(args.artefact) > 1 and {"none", "each"} & set(args.artefact):
        print("--artefact none and --artefact each stand alone", file=sys.stderr)
        return 2
    out, (index, count) = Path(args.out), args.shard
    done = {entry["trial"] for path in args.done for entry in read_lines(Path(path))}
    numbers = [n for n in range(args.first, args.first + args.count) if n % count == index]
    numbers = [n for n in numbers if name_of(n) not in done]
    entries: list[dict[str, Any]] = []

    def wish(number: int) -> Wish:
        some: tuple[str, ...] | None = tuple(args.artefact) or None
        if some in (("none",), ("each",)):
            some = (ARTEFACTS[number % len(ARTEFACTS)],) if some == ("each",) else ()
        return Wish(tuple(args.machines), args.kind, some, args.noise)

    with ProcessPoolExecutor(args.workers, initializer=one_thread) as pool:
        waiting = [pool.submit(make, n, args.seed, out, wish(n)) for n in numbers]
        for made in as_completed(waiting):
            entries.append(made.result())
            if len(entries) % 20 == 0 or len(entries) == len(numbers):
                print(f"{len(entries)} of {len(numbers)}", file=sys.stderr, flush=True)
    dropped = [entry for entry in entries if "dropped" in entry]
    kinds = Counter(entry["kind"] for entry in entries if "dropped" not in entry)
    print(f"{len(entries) - len(dropped)} trials ({dict(kinds)}), {len(dropped)} dropped")
    for entry in dropped:
        print(f"  {entry['trial']} {entry['machine']} {entry['kind']}: {entry['dropped']}")
    return 0


def one_thread() -> None:
    """Keeps a worker to one thread: libraries ask for the number of cores to start threads."""
    os.environ["OMP_NUM_THREADS"] = "1"


def run(args: argparse.Namespace) -> int:
    from rigs.running import run_all

    return run_all(args)


def one(args: argparse.Namespace) -> int:
    """A tool on a single trial, in a process of its own (used by `run`)."""
    if args.tool == "diagnose":
        from rigs.diagnosing import diagnosed

        return diagnosed(Path(args.folder), args.seconds, args.seed, args.half)
    from rigs.peers import fitted

    return fitted(Path(args.folder), args.tool, args.seconds)


def score(args: argparse.Namespace) -> int:
    from rigs.scoring import write_scores

    return write_scores(Path(args.trials), [Path(p) for p in args.results], Path(args.out))


def stability(args: argparse.Namespace) -> int:
    from rigs.stability import write_table

    changed = {}
    for words in args.against:
        name, _, path = words.rpartition("=")
        if not name:
            print(f"{words!r} is not WORDS=RESULTS, as in half=half.jsonl", file=sys.stderr)
            return 2
        changed[name] = Path(path)
    return write_table(Path(args.trials), Path(args.results), changed, Path(args.out))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("generate", help="write trials and the truth about them")
    making.add_argument("--out", required=True)
    making.add_argument("--seed", type=int, default=1)
    making.add_argument("--count", type=int, default=300)
    making.add_argument("--first", type=int, default=0, help="number of the first trial")
    making.add_argument("--machines", nargs="+", default=[], help="only these")
    making.add_argument(
        "--kind",
        default="",
        choices=("", "none", "single", "pair", "outside", "triple", "many"),
        help="triple: three effects; many: friction at every joint, a payload and one effect more. "
        "Default: drawn, none of these two",
    )
    making.add_argument(
        "--artefact",
        nargs="+",
        default=[],
        metavar="NAME",
        help="each trial has these and no other; `none`: white noise only; `each`: trial after "
        "trial one of them in turn. Default: drawn",
    )
    making.add_argument("--noise", type=float, default=1.0, help="factor on the noise")
    making.add_argument("--done", nargs="+", default=[], help="results: leave out what has one")
    making.add_argument("--workers", type=int, default=1)
    making.add_argument("--shard", type=shard_of, default=(0, 1), metavar="I/N")
    making.set_defaults(work=generate)
    running = commands.add_parser("run", help="let the diagnosis and its peers work on trials")
    running.add_argument("--trials", required=True, help="what `generate` wrote")
    running.add_argument("--out", required=True, help="one JSON line for each trial and tool")
    running.add_argument("--tools", nargs="+", choices=TOOLS, default=list(TOOLS))
    running.add_argument("--only", nargs="+", default=[], help="names of trials")
    running.add_argument("--limit", type=int, default=0, help="so many trials, in their order")
    running.add_argument("--workers", type=int, default=1)
    running.add_argument("--shard", type=shard_of, default=(0, 1), metavar="I/N")
    running.add_argument("--timeout", type=float, default=600.0, help="s, for each diagnosis")
    running.add_argument("--peer-timeout", type=float, default=120.0, help="s, for each peer's fit")
    running.add_argument(
        "--time-limit",
        type=float,
        default=0.0,
        help="s, for all; what could not end in it at worst is not begun",
    )
    running.add_argument("--seed", type=int, default=0, help="of the diagnosis")
    running.add_argument(
        "--half", action="store_true", help="give the diagnosis half of the recordings only"
    )
    running.add_argument("--again", action="store_true", help="also what has failed")
    running.set_defaults(work=run)
    single = commands.add_parser("one")
    single.add_argument("folder")
    single.add_argument("--tool", choices=TOOLS, default=TOOLS[0])
    single.add_argument("--seconds", type=float, default=300.0)
    single.add_argument("--seed", type=int, default=0)
    single.add_argument("--half", action="store_true")
    single.set_defaults(work=one)
    comparing = commands.add_parser("stability", help="the same trials, diagnosed under changes")
    comparing.add_argument("--trials", required=True)
    comparing.add_argument("--results", required=True, help="of `run` as it is by default")
    comparing.add_argument(
        "--against",
        nargs="+",
        required=True,
        metavar="WORDS=RESULTS",
        help="another seed (`run --seed 1`), half of the recordings (`run --half`), doubled noise "
        "(`generate --noise 2`, then `run`)",
    )
    comparing.add_argument("--out", required=True)
    comparing.set_defaults(work=stability)
    scoring = commands.add_parser("score", help="open the truth and count")
    scoring.add_argument("--trials", required=True)
    scoring.add_argument("--results", required=True, nargs="+")
    scoring.add_argument("--out", required=True)
    scoring.set_defaults(work=score)
    args = parser.parse_args(argv)
    return int(args.work(args))


if __name__ == "__main__":
    raise SystemExit(main())
