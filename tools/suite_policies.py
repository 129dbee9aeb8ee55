"""Analytic gradients through the learned step against PPO and SAC, on tasks of dm_control's suite.

APG is trained in the zoo's dynamics of the task, PPO and SAC in C MuJoCo, with as many true control
steps as those dynamics were trained on (or --steps). All are evaluated in C MuJoCo, by dm_control's
own reward. One line of JSON for each policy; what stands in --out is not run again, and a training
that was killed goes on.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(_ROOT / "tools"), str(_ROOT), str(_ROOT / "backends")]

import numpy as np  # noqa: E402
import torch  # noqa: E402
from from_source import register  # noqa: E402
from orbisim_policies.apg import ApgConfig  # noqa: E402
from orbisim_policies.checkpoint import MANIFEST, load_policy, read_manifest  # noqa: E402
from orbisim_policies.evaluate import evaluate  # noqa: E402
from orbisim_policies.learned import LearnedWorlds  # noqa: E402
from orbisim_policies.network import NetworkConfig  # noqa: E402
from orbisim_policies.run import Run, train_apg  # noqa: E402
from orbisim_policies.suite import SUITE, SuiteProblem  # noqa: E402

from orbisim.files.reading import read_json  # noqa: E402

METHODS = ("apg", "ppo", "sac")
WORLDS = {"ppo": 32, "sac": 8}
"""At once: PPO learns from many, SAC makes one update for each eight steps."""
RATES = {"apg": 5e-4, "ppo": 3e-4, "sac": 3e-4}
"""Of Adam: what push and the pendulum were trained with, and Stable-Baselines3's defaults."""
HORIZON = 25
"""Control steps whose gradients APG takes at once: it divides episodes of 1,000."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A policy, and what it may use.

    Attributes:
      task, method, seed: which one. work: folder of trainings.
      steps: true control steps of PPO and SAC; those of the dynamics' data if None.
      limit: seconds of APG; None for none. iterations: of APG; None for none.
      worlds: of APG. length: of an episode; dm_control's if None.
      episodes: of the evaluation. device: of APG. compiled: its step, by torch.
    """

    task: str
    method: str
    seed: int
    work: Path
    steps: int | None
    limit: float | None
    iterations: int | None
    worlds: int
    length: int | None
    episodes: int
    device: str
    compiled: bool

    @property
    def key(self) -> tuple[str, str, int]:
        """Which policy."""
        return self.task, self.method, self.seed


def true_steps(problem: SuiteProblem) -> int:
    """Control steps of MuJoCo that the zoo's dynamics of a task were trained on."""
    worlds = LearnedWorlds(problem, None, torch.device("cpu"))
    return int(read_json(worlds.folder / "manifest.json")["data"]["control_steps"])


def train(job: Job) -> dict[str, Any]:
    """Trains a policy and evaluates it."""
    problem, began = SuiteProblem(job.task, job.length), time.monotonic()
    out = job.work / f"{job.task}-{job.method}-{job.seed}"
    known = (out / MANIFEST).exists() and read_manifest(out)["training"]["finished"]
    if not known:
        run = Run(out, seed=job.seed, check=0, resume=out.exists())
        if job.method == "apg":
            config = ApgConfig(
                batch=job.worlds,
                horizon=HORIZON,
                rate=RATES["apg"],
                final_rate=RATES["apg"] / 10,
                network=NetworkConfig(),
            )
            budget = {"steps": job.iterations, "limit": job.limit, "device": job.device}
            run = dataclasses.replace(run, compiled=job.compiled, **budget)
            train_apg(problem, config, run)
        else:
            from orbisim_policies.baselines import Baseline, train_baseline

            run = dataclasses.replace(run, steps=job.steps or true_steps(problem))
            batch, rate = WORLDS[job.method], RATES[job.method]
            train_baseline(problem, Baseline(job.method, batch=batch, rate=rate), run)
    policy, manifest = load_policy(out, problem), read_manifest(out)
    worlds = None
    if job.method == "apg":
        worlds = LearnedWorlds(problem, None, torch.device("cpu"))
    result = evaluate(problem, policy, episodes=job.episodes, seeds=(0,), worlds=worlds)
    found = dict(zip(("task", "method", "seed"), job.key, strict=True))
    found |= {"true_steps": manifest["true_steps"], "steps_of_episode": problem.steps}
    found |= {"training": manifest["training"], "diverged": result["diverged"]}
    for name in ("mujoco", "model"):
        if name in result:
            reward = result[name]["reward"]["return"]
            found[name] = {key: value * problem.steps for key, value in reward.items()}
    return {**found, "episodes": job.episodes, "seconds": round(time.monotonic() - began, 1)}


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The policies of a file; a line that was cut off by a kill is left out."""
    lines = path.read_text().splitlines(keepends=True) if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("\n")]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each task and method: the mean over seeds, every seed, and true steps."""
    lines = [
        "| task | method | seeds | return in C MuJoCo | each seed | in the model | true steps |"
    ]
    lines.append("| --- | --- | --- | --- | --- | --- | --- |")
    for task in SUITE:
        for method in METHODS:
            mine = [row for row in rows if (row["task"], row["method"]) == (task, method)]
            if not mine:
                continue
            returns = [row["mujoco"]["mean"] for row in mine]
            each = ", ".join(
                f"{one:.0f} ± {row['mujoco']['ci95_half']:.0f}"
                for one, row in zip(returns, mine, strict=True)
            )
            inside = [row["model"]["mean"] for row in mine if "model" in row]
            steps = sorted({int(row["true_steps"]) for row in mine})
            cells = [task, method, str(len(mine)), f"{np.mean(returns):.0f}", each]
            cells += [f"{np.mean(inside):.0f}" if inside else ""]
            cells += [" to ".join(f"{one:,}" for one in dict.fromkeys((steps[0], steps[-1])))]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Trains what is missing, one after the other, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/suite_policies.jsonl"))
    parser.add_argument("--work", type=Path, default=Path("out/suite_policies"))
    parser.add_argument("--tasks", nargs="*", default=list(SUITE), choices=list(SUITE))
    parser.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--steps", type=int, help="true steps of ppo, sac; default: of the data")
    parser.add_argument("--limit", type=float, help="of apg, s; default 440, or --iterations")
    parser.add_argument("--iterations", type=int, help="of apg")
    parser.add_argument("--worlds", type=int, default=512, help="of apg")
    parser.add_argument("--length", type=int, help="control steps of an episode")
    parser.add_argument("--episodes", type=int, default=30, help="of each evaluation")
    parser.add_argument("--device", default="cpu", help="of apg")
    parser.add_argument("--compiled", action="store_true", help="torch compiles apg's step")
    parser.add_argument("--time-limit", type=float, help="s, after which no training is begun")
    options = parser.parse_args()
    register()
    began, rows = time.monotonic(), read_rows(options.out)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    limit = 440.0 if options.limit is None and options.iterations is None else options.limit
    failed = False
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for task in options.tasks:
            for method in options.methods:
                job = Job(
                    task,
                    method,
                    seed,
                    options.work,
                    options.steps,
                    limit,
                    options.iterations,
                    options.worlds,
                    options.length,
                    options.episodes,
                    options.device,
                    options.compiled,
                )
                late = options.time_limit and time.monotonic() - began > options.time_limit
                if late or job.key in {(r["task"], r["method"], r["seed"]) for r in rows}:
                    continue
                try:
                    rows.append(train(job))
                except Exception as error:  # the others go on; the tool says so at its end
                    print(f"{job.key}: {type(error).__name__}: {error}", flush=True)
                    failed = True
                    continue
                with options.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
                mean = rows[-1]["mujoco"]["mean"]
                print(*job.key, f"{mean:.0f}", f"{rows[-1]['seconds']} s", flush=True)
    print(table(rows))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
