"""Methods that make policies, on equal terms: tasks, methods and seeds, one line of JSON for each.

`apg`, `shac` (gradients over short horizons that end in a value) and `bc_apg` (cloned first) learn
by analytic gradients in the zoo's dynamics of the task, `apg_mujoco` by those of C MuJoCo's finite
differences, `bc` from the task's script, `ppo`, `ppo_rnd`, `sac` and `dreamer` by trying in C
MuJoCo. All have the same observations, actions,
rewards, episodes, seconds (--limit) and, where they try, at most the same true control steps. The
policy that is kept is of every method the best by 48 episodes on the way, the same for all. All are
evaluated in C MuJoCo, and beside it inside the learned dynamics.

--search tries four configurations of each method (`SPACE`) with a seed of their own, on the same
budget (`SEARCH`): the same seconds and at most the same true control steps each, which for clones
are those of their demonstrations. Without it, every method has the configuration that did best
there, and its first one if none was searched for. What stands in --out is not run again, and a
training that was killed goes on.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(_ROOT / "tools"), str(_ROOT), str(_ROOT / "backends")]

import torch  # noqa: E402
from from_source import register  # noqa: E402
from orbisim_policies.apg import ApgConfig  # noqa: E402
from orbisim_policies.checkpoint import MANIFEST, load_policy, read_manifest  # noqa: E402
from orbisim_policies.cloning import CloneConfig  # noqa: E402
from orbisim_policies.differenced import DifferencedWorlds  # noqa: E402
from orbisim_policies.dreamer import DreamerConfig, train_dreamer  # noqa: E402
from orbisim_policies.evaluate import evaluate  # noqa: E402
from orbisim_policies.learned import LearnedWorlds  # noqa: E402
from orbisim_policies.problem import Problem  # noqa: E402
from orbisim_policies.problems import make_problem  # noqa: E402
from orbisim_policies.push import PushProblem  # noqa: E402
from orbisim_policies.run import METRICS, Run, train_apg, train_clone  # noqa: E402
from orbisim_policies.suite import SUITE  # noqa: E402
from plans import carry_out, left, read_rows  # noqa: E402
from policy_table import curves, figure, table  # noqa: E402

METHODS = ("bc", "apg", "shac", "bc_apg", "apg_mujoco", "ppo", "ppo_rnd", "sac", "dreamer")
GRADIENTS = ("apg", "shac", "bc_apg")
"""Methods that differentiate the learned step."""
ON_DEVICE = (*GRADIENTS, "dreamer")
"""What is trained on --device; the others, whose networks are small, are not faster there."""
DYNAMICS = {"task:push": "push_contacts"}
"""Checkpoint of the zoo that a task is trained in; if not here, the one that fits best."""
SEARCH_SEED = 100
"""Of trainings that are searched; none of the seeds that are reported."""
CHECK = 48
"""Episodes of a live estimate."""
SPACE: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "bc": ({}, {"rate": 3e-4}, {"rate": 3e-3}, {"batch": 512}),
    "apg": ({"rate": 2e-4}, {"rate": 5e-4}, {"rate": 2e-4, "noise": 0.4}, {"rate": 1e-4}),
    "shac": ({"rate": 2e-4}, {"rate": 5e-4}, {"rate": 2e-4, "horizon": 32}, {"rate": 1e-3}),
    "bc_apg": ({"rate": 5e-5}, {"rate": 2e-5}, {"rate": 1e-4}, {"rate": 5e-5, "noise": 0.2}),
    "apg_mujoco": ({"rate": 5e-4}, {"rate": 2e-4}, {"rate": 1e-3}, {"rate": 5e-4, "batch": 64}),
    "ppo": ({}, {"rate": 1e-3}, {"window": 64}, {"rate": 1e-3, "window": 64}),
    "ppo_rnd": ({}, {"rate": 1e-3}, {"curiosity": 0.01}, {"rate": 1e-3, "curiosity": 0.01}),
    "sac": ({}, {"rate": 1e-3}, {"returns": 16}, {"returns": 16, "updates": 4}),
    "dreamer": ({}, {"rate": 1e-3}, {"ratio": 128.0}, {"entropy": 3e-3}),
}
"""Four configurations of each method: changes of `BASE`; the first is what it has unsearched."""
SEARCH: Mapping[str, Any] = {"steps": 40_000, "demonstrations": 625, "limit": 280.0}
"""What each configuration may use where --search is not told otherwise. Demonstrations of 64 steps
each are as many true steps as the others have; 280 s are what SAC needs for them, with one update
for eight steps."""
BUDGET: Mapping[str, Any] = {"steps": 250_000, "demonstrations": 1000, "limit": 400.0}
"""The same of policies that are reported."""
HORIZON, SPARSE_HORIZON = 25, 16
"""Control steps whose gradients are taken at once in tasks of the suite, and, by `shac`, where the
reward comes at the end: they divide episodes of 1,000 and of 64 steps."""
BASE: Mapping[str, Mapping[str, Any]] = {
    "bc_apg": {"noise": 0.1},
    "apg_mujoco": {"batch": 16, "horizon": HORIZON},
    "ppo": {"batch": 32},
    "ppo_rnd": {"batch": 32},
    "sac": {"batch": 8},
}
"""PPO learns from many worlds, SAC makes one update for each eight steps; noise before the bounds
of actions would undo what a clone knows."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A policy, and what it may use.

    Attributes:
      kind: `search`, of a configuration, or `policy`. task, method, seed: which one.
      choice: number of its configuration. work: folder of trainings.
      steps: true control steps of what tries, at most. limit: seconds of the training.
      worlds: of analytic gradients. length: of an episode; the task's if None.
      episodes: of the evaluation. device: of what is trained there. threads: of MuJoCo.
      compiled: the learned step, by torch. check_every: seconds.
      demonstrations: episodes that are imitated. cloning: steps of it before analytic gradients.
    """

    kind: str
    task: str
    method: str
    seed: int
    choice: int
    work: Path
    steps: int | None
    limit: float | None
    worlds: int
    length: int | None
    episodes: int
    device: str
    threads: int
    compiled: bool
    check_every: float
    demonstrations: int
    cloning: int

    @property
    def key(self) -> tuple[str, str, str, int, int]:
        """Which policy; of a policy that is reported, whatever its configuration."""
        return (self.kind, *self.place, self.choice if self.kind == "search" else -1)

    @property
    def place(self) -> tuple[str, str, int]:
        """Which task, method and seed."""
        return self.task, self.method, self.seed

    @property
    def lane(self) -> str:
        """Where it is trained."""
        return "device" if self.method in ON_DEVICE else "processor"


def dynamics_of(problem: Problem, device: torch.device) -> LearnedWorlds:
    """The learned step that a task's policies are trained and tried in."""
    return LearnedWorlds(problem.to(device), DYNAMICS.get(problem.name), device)


def settings(job: Job, problem: Problem) -> dict[str, Any]:
    """What is not said otherwise by a method's defaults."""
    found = dict(BASE.get(job.method, {})) | dict(SPACE[job.method][job.choice])
    if job.method == "apg_mujoco":
        found["final_rate"] = found["rate"] / 10
    if job.method in GRADIENTS:
        found |= {"batch": job.worlds, "final_rate": found["rate"] / 10}
        horizon = min(SPARSE_HORIZON, problem.steps) if job.method == "shac" else 0
        found = {"horizon": horizon if problem.sparse else HORIZON, **found}
        if not problem.sparse:
            found |= {"rate": 2.5 * found["rate"], "final_rate": 0.25 * found["rate"]}
    return found


def learn(job: Job, problem: Problem, out: Path) -> None:
    """Trains a policy, unless it is done."""
    if (out / MANIFEST).exists() and read_manifest(out)["training"]["finished"]:
        return
    began, changes = time.monotonic(), settings(job, problem)
    run = Run(
        out,
        limit=job.limit,
        seed=job.seed,
        check=CHECK,
        check_every=job.check_every,
        resume=out.exists(),
        nthread=job.threads,
        demonstrations=job.demonstrations,
    )
    if job.method in ON_DEVICE:
        run = dataclasses.replace(run, device=job.device, compiled=job.compiled)
    if job.method == "bc":
        assert isinstance(problem, PushProblem)
        train_clone(problem, CloneConfig(**changes), run)
    elif job.method in GRADIENTS:
        if job.method == "bc_apg":
            assert isinstance(problem, PushProblem)
            clone = dataclasses.replace(run, out=out.with_name(f"{out.name}-clone"), check=0)
            clone = dataclasses.replace(
                clone, limit=None, steps=job.cloning, resume=clone.out.exists()
            )
            train_clone(problem, CloneConfig(), clone)
            spent = time.monotonic() - began
            limit = None if run.limit is None else max(run.limit - spent, 1.0)
            run = dataclasses.replace(run, start=clone.out, limit=limit)
        train_apg(problem, ApgConfig(**changes), run, DYNAMICS.get(problem.name))
    elif job.method == "apg_mujoco":
        config = ApgConfig(**changes)
        cost = DifferencedWorlds(problem).true_per_step * config.batch * config.horizon
        budget = None if job.steps is None else max(1, job.steps // cost)
        train_apg(problem, config, dataclasses.replace(run, steps=budget), differences=True)
    else:
        run = dataclasses.replace(run, steps=job.steps)
        if job.method == "dreamer":
            train_dreamer(problem, DreamerConfig(**changes), run)
            return
        # here, so that the rest needs no Stable-Baselines3
        from orbisim_policies.baselines import Baseline, train_baseline

        train_baseline(problem, Baseline(job.method, **changes), run)


def work(job: Job) -> dict[str, Any]:
    """Trains a policy and evaluates it."""
    torch.set_num_threads(1)
    problem, began = make_problem(job.task, job.length), time.monotonic()
    name = "-".join(map(str, (job.kind, *job.place, job.choice))).replace(":", "_")
    out = job.work / name
    learn(job, problem, out)
    manifest, trained = read_manifest(out), time.monotonic() - began
    device = torch.device(job.device if job.method in ON_DEVICE else "cpu")
    worlds = dynamics_of(problem, device) if job.kind == "policy" else None
    seed = 0 if job.kind == "policy" else SEARCH_SEED
    how: Any = {"episodes": job.episodes, "seeds": (seed,), "worlds": worlds}
    result = evaluate(problem, load_policy(out, problem), **how, nthread=job.threads)
    found: dict[str, Any] = {"kind": job.kind, "task": problem.name}
    found |= {"method": job.method, "seed": job.seed, "choice": job.choice}
    found |= {"settings": settings(job, problem), "steps_of_episode": problem.steps}
    found |= {"true_steps": manifest["true_steps"], "check": manifest["check"]}
    found |= {"training": manifest["training"], "diverged": result["diverged"]}
    found |= {name: result[name] for name in ("mujoco", "model") if name in result}
    found |= {"curve": curves(out / METRICS, manifest, problem), "policy": str(out)}
    return found | {"trained_s": round(trained, 1), "seconds": round(time.monotonic() - began, 1)}


def key_of(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """The key of the job that a row is of."""
    choice = row["choice"] if row["kind"] == "search" else -1
    return row["kind"], row["task"], row["method"], row["seed"], choice


def worth(row: Mapping[str, Any]) -> float:
    """The reward of an evaluation in C MuJoCo, the sum of its parts."""
    return float(sum(part["mean"] for part in row["mujoco"]["reward"].values()))


def best(rows: Sequence[Mapping[str, Any]], task: str, method: str) -> int:
    """The configuration with the highest reward in the search; the first without one."""
    mine = [
        row for row in rows if (row["kind"], row["task"], row["method"]) == ("search", task, method)
    ]
    return int(max(mine, key=worth)["choice"]) if mine else 0


def budget(options: argparse.Namespace) -> None:
    """What was not said is that of a search, or of policies that are reported."""
    for name, value in (SEARCH if options.search else BUDGET).items():
        if getattr(options, name) is None:
            setattr(options, name, value)


def main() -> None:
    """Trains what is missing, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/compare_policies.jsonl"))
    parser.add_argument("--work", type=Path, default=Path("out/compare_policies"))
    parser.add_argument("--tasks", nargs="*", default=["task:push"], help="or suite for its five")
    parser.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    parser.add_argument("--search", action="store_true", help="configurations, not policies")
    parser.add_argument(
        "--choices", nargs="*", default=[], help="configurations by number, as ppo=3 sac=1"
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--steps", type=int, help="true steps of what tries")
    parser.add_argument("--limit", type=float, help="of each training, s")
    parser.add_argument("--worlds", type=int, default=512, help="of analytic gradients")
    parser.add_argument("--demonstrations", type=int, help="that are imitated")
    parser.add_argument("--cloning", type=int, default=4000, help="steps before bc_apg's own")
    parser.add_argument("--length", type=int, help="control steps of an episode")
    parser.add_argument("--episodes", type=int, default=200, help="of each evaluation")
    parser.add_argument("--device", default="cpu", help=f"of {', '.join(ON_DEVICE)}")
    parser.add_argument("--compiled", action="store_true", help="torch compiles the learned step")
    parser.add_argument("--jobs", type=int, default=1, help="processes of all other methods")
    parser.add_argument("--device-jobs", type=int, default=1, help="processes on --device")
    parser.add_argument("--threads", type=int, default=1, help="of MuJoCo, on --device's jobs")
    parser.add_argument("--check-every", type=float, default=30.0, help="s between estimates")
    parser.add_argument("--time-limit", type=float, help="s, after which no training is begun")
    parser.add_argument("--figure", type=Path, help="curves and success of all rows")
    options = parser.parse_args()
    budget(options)
    register()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the processes that are begun
    tasks = [
        name
        for given in options.tasks
        for name in ([f"suite:{one}" for one in SUITE] if given == "suite" else [given])
    ]
    rows, jobs = read_rows(options.out), []
    given = {name: int(number) for name, _, number in (c.partition("=") for c in options.choices)}
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for seed in (SEARCH_SEED,) if options.search else seeds:
        for method in options.methods:
            for task in tasks:
                if method in ("bc", "bc_apg") and task != PushProblem.name:
                    continue  # there is no script to imitate
                if method == "apg_mujoco" and task == PushProblem.name:
                    continue  # each episode has a scene of its own
                choice = given.get(method, best(rows, task, method))
                choices = range(len(SPACE[method])) if options.search else [choice]
                for choice in choices:
                    jobs.append(
                        Job(
                            "search" if options.search else "policy",
                            task,
                            method,
                            seed,
                            choice,
                            options.work,
                            options.steps,
                            options.limit,
                            options.worlds,
                            options.length,
                            options.episodes,
                            options.device,
                            options.threads if method in ON_DEVICE else 1,
                            options.compiled,
                            options.check_every,
                            options.demonstrations,
                            options.cloning,
                        )
                    )
    fresh, failed = carry_out(
        left(jobs, map(key_of, rows)),
        work,
        options.out,
        lanes=lambda job: job.lane,
        jobs={"processor": options.jobs, "device": options.device_jobs},
        prepare=register,
        time_limit=options.time_limit,
        say=lambda row: f"{worth(row):.3f}",
    )
    rows += fresh
    print(table(rows))
    if options.figure:
        figure(rows, options.figure)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
