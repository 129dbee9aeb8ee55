"""Environment steps per second of `task:push` in the learned step, all on the device.

A step has everything that a policy's environment has: observation, policy, inverse kinematics, the
learned step, rewards. Nothing is copied to the host.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np
import torch
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.problems import make_problem
from orbisim_policies.rollout import Running, acted, began, worth
from orbisim_world_model.entities import Entities
from orbisim_world_model.graphs import Graphed
from torch import Tensor

from orbisim.files.writing import write_json


def measure(worlds: LearnedWorlds, count: int, compiled: bool, repeats: int) -> dict[str, float]:
    """Median and 90 % of the environment steps per second in `count` worlds."""
    problem = worlds.problem
    pool = worlds.pool(problem.draw(range(min(count, 256))))
    index = torch.arange(count, device=worlds.device) % len(pool.qpos)
    policy = Policy(problem.observations, problem.actions, NetworkConfig()).to(worlds.device)
    first = began(worlds, pool.at(index))
    fields, noise = len(Entities._fields), torch.zeros((), device=worlds.device)

    def flat(*given: Tensor) -> tuple[Tensor, ...]:
        now = Running(Entities(*given[:fields]), *given[fields:])
        after, _ = acted(worlds, policy, now, noise, 0.0)
        return (*after.x, after.command, after.score, after.done, worth(worlds, after))

    step = torch.compile(flat, dynamic=False, fullgraph=True) if compiled else flat
    state = [*first.x, *first[1:]]
    moving = [tensor.clone() for tensor in state[: fields + 3]]

    def once() -> Tensor:
        found = step(*moving, *state[fields + 3 :])
        for mine, new in zip(moving, found[:-1], strict=True):
            mine.copy_(new)
        return found[-1]

    def synchronize() -> None:
        if worlds.device.type == "cuda":
            torch.cuda.synchronize()

    with torch.no_grad():
        once()
        run = Graphed(once, lambda: None, worlds.device.type == "cuda")
        rates = []
        for _ in range(repeats):
            for mine, start in zip(moving, state, strict=False):
                mine.copy_(start)
            synchronize()
            began_at = time.perf_counter()
            for _ in range(problem.steps):
                value = run()
            synchronize()
            rates.append(count * problem.steps / (time.perf_counter() - began_at))
    assert value.isfinite().all()
    median, low = np.median(rates), np.quantile(rates, 0.1)
    return {"median": float(median), "p10": float(low), "worst": min(rates)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--worlds", type=int, nargs="*", default=[1, 64, 4096, 16384])
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--half", action="store_true", help="network in half precision")
    parser.add_argument("--compiled", action="store_true", help="step compiled by torch")
    parser.add_argument("--repeats", type=int, default=20, help="episodes")
    parser.add_argument("--steps", type=int, default=64, help="of an episode")
    parser.add_argument("--out", type=Path, default=Path("out/bench_policies.json"))
    options = parser.parse_args()
    device = torch.device(options.device)
    torch.backends.cuda.matmul.allow_tf32 = True
    problem = make_problem("push", options.steps)
    worlds = LearnedWorlds(problem.to(device), None, device)
    worlds.model.eval()
    if options.half:
        worlds.model.network.half()
        worlds._memory = worlds.model.initial_memory(1)
    rows = {}
    for count in options.worlds:
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            rows[count] = measure(worlds, count, options.compiled, options.repeats)
        print(f"{count:>7} worlds: {rows[count]['median']:.4g} environment steps/s", flush=True)
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"
    settings = {**vars(options), "out": str(options.out), "on": name}
    write_json(options.out, {"options": settings, "steps_per_s": rows})
    print(json.dumps({"out": str(options.out)}))


if __name__ == "__main__":
    main()
