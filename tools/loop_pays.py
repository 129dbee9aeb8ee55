"""What closing the loop is worth: policies for machines that their scenes do not describe.

Four machines differ from their scenes by effects that these do not declare: a cart and pole with
friction and a late motor, an arm with a load and friction, a gripper whose box slides farther, a
leg whose servos have play. Policies are trained by PPO, tried on the machine, and differ in what
they were trained on:

declared: the scene as it is. randomised: the scene with effects drawn widely for each episode.
hybrid: MuJoCo's step with a correction learned from four recordings of the machine. diagnosed: the
scene with what `orbisim.diagnose` finds in the same recordings. true: the machine's own scene,
which nobody has.

Everything is drawn anew with each seed: recordings, weights, episodes. What stands in --out is not
run again. Conditions are run in the order of --only: where processes are many, name `diagnosed`
first, which takes longest.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(_ROOT / "tools"), str(_ROOT), str(_ROOT / "backends")]

from from_source import register  # noqa: E402
from paying.conditions import CONDITIONS, DUTIES  # noqa: E402
from paying.table import figure, table  # noqa: E402
from paying.training import Plan, train  # noqa: E402
from plans import carry_out, left, read_rows  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/loop_pays.jsonl"))
    parser.add_argument("--work", type=Path, default=Path("out/loop_pays"))
    parser.add_argument("--scenes", nargs="*", default=list(DUTIES), choices=list(DUTIES))
    parser.add_argument("--only", nargs="*", default=CONDITIONS, choices=CONDITIONS)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=128_000, help="of training, each policy")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--patience", type=float, default=600.0, help="of a diagnosis, s")
    parser.add_argument("--fit", type=float, default=120.0, help="of a learned correction, s")
    parser.add_argument("--time-limit", type=float, help="s, after which nothing is begun")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    register()
    rows = read_rows(options.out)
    budget = (options.steps, options.episodes, options.patience, options.fit)
    plans = [
        Plan(scene, condition, seed, options.work, *budget)
        for condition in options.only
        for seed in range(options.first_seed, options.first_seed + options.seeds)
        for scene in options.scenes
    ]
    known = [(row["scene"], row["condition"], row["seed"]) for row in rows]
    fresh, failed = carry_out(
        left(plans, known),
        train,
        options.out,
        jobs=options.jobs,
        prepare=register,
        time_limit=options.time_limit,
        say=lambda row: f"{row['machine']['share']:.2f}",
    )
    rows += fresh
    print(table(rows))
    if options.figure:
        figure(rows, options.figure)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
