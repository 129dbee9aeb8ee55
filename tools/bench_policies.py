"""Environment steps per second of tasks in the learned step, all on the device.

    python tools/bench_policies.py --out out/bench_policies.json
    python tools/bench_policies.py --tasks suite:cartpole-swingup suite:cheetah-run --steps 1000

A step of `DeviceEnvironment` has everything that a policy's environment has: inverse kinematics,
the learned step, observations, rewards, ends of episodes and new episodes. Nothing is copied to
the host. Measured with random actions, and with a policy that acts on the observations.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from orbisim_policies.environment import DeviceEnvironment
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.problems import available, make_problem

from orbisim.files.writing import write_json


def runs(
    task: str, worlds: int, device: str, steps: int, compiled: bool
) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """A step under random actions, and one under a policy; the same worlds go on."""
    problem = make_problem(task, steps)
    how: dict[str, Any] = {"device": device, "starts": min(worlds, 256), "compiled": compiled}
    environment = DeviceEnvironment(problem, worlds, **how)
    view = environment.reset()["observations"]
    policy = Policy(problem.observations, problem.actions, NetworkConfig()).to(view.device)
    actions = torch.rand((4, worlds, problem.actions), device=view.device) * 2 - 1
    state = {"step": 0, "view": view}

    def random() -> None:
        state["step"] += 1
        found = environment.step(actions[state["step"] % 4])
        state["view"] = found.observation["observations"]

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def acted() -> None:
        found = environment.step(policy(state["view"]))
        state["view"] = found.observation["observations"]

    return random, acted


def rate(run: Callable[[], Any], worlds: int, device: str, steps: int, repeats: int) -> Any:
    """Median, 10 % and worst of the environment steps per second, of `repeats` of `steps` steps."""
    rates = []
    run()
    for _ in range(repeats):
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        began = time.perf_counter()
        for _ in range(steps):
            run()
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        rates.append(worlds * steps / (time.perf_counter() - began))
    return {
        "median": float(np.median(rates)),
        "p10": float(np.quantile(rates, 0.1)),
        "worst": min(rates),
    }


def main() -> None:
    """Measures each number of worlds; writes after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="*", default=["task:push"], choices=available())
    parser.add_argument("--worlds", type=int, nargs="*", default=[1, 64, 4096, 16384, 65536])
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--count", type=int, default=64, help="control steps of a repeat")
    parser.add_argument("--steps", type=int, default=64, help="of an episode")
    parser.add_argument("--plain", action="store_true", help="not compiled by torch")
    parser.add_argument("--out", type=Path, default=Path("out/bench_policies.json"))
    options = parser.parse_args()
    on_gpu = options.device.startswith("cuda")
    name = torch.cuda.get_device_name(options.device) if on_gpu else "cpu"
    settings = {**vars(options), "out": str(options.out), "on": name}
    found: dict[str, Any] = {"options": settings, "steps_per_s": {}}
    warnings.simplefilter("default")
    for task, worlds in itertools.product(options.tasks, options.worlds):
        measured = {
            label: rate(run, worlds, options.device, options.count, options.repeats)
            for label, run in zip(
                ("random actions", "policy"),
                runs(task, worlds, options.device, options.steps, not options.plain),
                strict=True,
            )
        }
        found["steps_per_s"].setdefault(task, {})[worlds] = measured
        write_json(options.out, found)
        medians = ", ".join(f"{row['median']:.4g} ({n})" for n, row in measured.items())
        print(f"{task}, {worlds:>7} worlds: environment steps/s {medians}", flush=True)
    print(json.dumps({"out": str(options.out)}))


if __name__ == "__main__":
    main()
