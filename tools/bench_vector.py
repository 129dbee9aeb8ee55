"""Environment steps per second of `orbisim.vector` and of what people use now, in one run.

    python tools/bench_vector.py --out out/bench_vector.json

For each task and number of worlds: `orbisim.vector` on C MuJoCo (all cores) and, with `--warp`, on
MuJoCo-Warp (arrays on the host, and tensors that stay on the device; `--profile STEPS` prints
where the time of a step goes) or, with `--learned`, in the zoo's dynamics where there are any
(first as they are, then compiled by torch, which takes minutes for each number of worlds);
dm_control's own environments in gymnasium's `AsyncVectorEnv` (by shimmy, one process for each
core, each with its share of the worlds one after the other); gymnasium's own MuJoCo environments
in `AsyncVectorEnv`, where there is one of that robot. Actions are random; episodes begin anew
where they end. Best of `--repeats`, each at least `--seconds` long. With `--playground PYTHON`,
mujoco_playground as well, by that Python (see bench_playground.py). Take the figures on a machine
that does nothing else.
"""

from __future__ import annotations

import argparse
import functools
import json
import logging
import os
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import from_source
import gymnasium
import numpy as np

import orbisim
from orbisim.host.cpus import usable_cpus

TASKS = {
    "cartpole-swingup": "InvertedPendulum-v5",
    "cheetah-run": "HalfCheetah-v5",
    "walker-walk": "Walker2d-v5",
    "humanoid-walk": "Humanoid-v5",
}
"""Tasks of the suite, and gymnasium's environment of a like robot."""

PLAYGROUND = {
    "cartpole-swingup": "CartpoleSwingup",
    "cheetah-run": "CheetahRun",
    "walker-walk": "WalkerWalk",
    "humanoid-walk": "HumanoidWalk",
}
"""The same tasks as mujoco_playground calls them."""

WORLDS = (1, 64, 4096, 16384)


class Several(gymnasium.Env):
    """A few environments one after the other in one process, seen as one."""

    def __init__(self, make: Callable[[], Any], count: int) -> None:
        self.parts = [make() for _ in range(count)]
        _be_quiet()
        nu = self.parts[0].action_space.shape[0]
        self.action_space = gymnasium.spaces.Box(-1, 1, (count * nu,), np.float64)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (count,), np.float64)
        self.nu = nu

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Resets all."""
        for part in self.parts:
            part.reset()
        return np.zeros(len(self.parts)), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Steps all; resets those that have ended at once."""
        rewards = np.zeros(len(self.parts))
        for i, part in enumerate(self.parts):
            _, rewards[i], ended, cut, _ = part.step(action[i * self.nu : (i + 1) * self.nu])
            if ended or cut:
                part.reset()
        return rewards, float(rewards.sum()), False, False, {}


def _be_quiet() -> None:
    """No warnings in this process: `dm_control.composer` has each deprecation shown, which under
    NumPy 2.5 is a line, and 5 % of the time, for each step of a cart and pole."""
    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")


def _shimmy(domain: str, task: str) -> Any:
    from dm_control import suite
    from shimmy.dm_control_compatibility import DmControlCompatibilityV0

    return DmControlCompatibilityV0(suite.load(domain, task))


def _gymnasium(name: str) -> Any:
    return gymnasium.make(name)


def rate(step: Callable[[], None], worlds: int, seconds: float, repeats: int) -> float:
    """The best number of environment steps per second."""
    step()
    best = 0.0
    for _ in range(repeats):
        begun, count = time.perf_counter(), 0
        while time.perf_counter() - begun < seconds:
            step()
            count += 1
        best = max(best, count * worlds / (time.perf_counter() - begun))
    return best


def ours(
    domain: str, task: str, worlds: int, backend: Any, options: Any, arrays: Any = "numpy"
) -> float:
    """`orbisim.vector`; with tensors, actions are on the device as a policy's would be."""
    environment = orbisim.vector.load(domain, task, worlds, backend, seed=0, arrays=arrays)
    first = next(iter(environment.reset().values()))
    spec, random = environment.action_spec(), np.random.default_rng(0)
    actions: Any = random.uniform(spec.minimum, spec.maximum, (16, worlds, *spec.shape))
    if arrays == "torch":
        actions = first.new_tensor(actions)
        said = f": {environment.reason}" if environment.reason else ""
        print("   ", domain, task, worlds, environment.evaluation + said, flush=True)
    chosen = iter(range(10**9))
    if options.profile and environment.evaluation == "on the device":
        steps = min(options.profile, int(environment._limit) - 1)
        print("    ms a step:", profiled(environment, actions, steps), flush=True)
        environment.reset()
    found = rate(
        lambda: environment.step(actions[next(chosen) % 16]) and None,
        worlds,
        options.seconds,
        options.repeats,
    )
    environment.close()
    return found


def plain(worlds: int) -> Any:
    """The learned step as it is, which needs no minutes of compiling first."""
    from orbisim_world_model.backend import LearnedBackend

    return LearnedBackend(nworld=worlds, compiled=False)


def profiled(environment: Any, actions: Any, steps: int) -> dict[str, Any]:
    """Where the time of steps on the device goes, ms a step; each part waits for the device.

    Returns:
      `step`: MuJoCo-Warp with the stages of the new state. `task`: its functions, ends of episodes.
      `rest`: what is neither. `together`: a step as it is, without waits between its parts.
      `reset`: of all worlds, s. `graph`: whether the task's functions are a CUDA graph, or why not.
    """
    import torch

    parts = {"step": (environment._worlds, "step"), "task": (environment._program, "run")}
    seconds = dict.fromkeys((*parts, "all"), 0.0)
    device = environment._device

    def wait() -> None:
        if device.type == "cuda":
            torch.cuda.synchronize(device)

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            wait()
            begun = time.perf_counter()
            result = function(*args)
            wait()
            seconds[name] += time.perf_counter() - begun
            return result

        return call

    begun = time.perf_counter()
    environment.reset()
    wait()
    reset = time.perf_counter() - begun
    for k in range(4):  # graphs are recorded
        environment.step(actions[k % len(actions)])
    wait()
    begun = time.perf_counter()
    for k in range(steps):
        environment.step(actions[k % len(actions)])
    wait()
    together = time.perf_counter() - begun
    environment.reset()
    for name, (owner, method) in parts.items():
        setattr(owner, method, timed(name, getattr(owner, method)))
    whole = timed("all", environment.step)
    for k in range(steps):
        whole(actions[k % len(actions)])
    for owner, method in parts.values():
        delattr(owner, method)
    seconds["rest"] = seconds.pop("all") - seconds["step"] - seconds["task"]
    found: dict[str, Any] = {n: round(1e3 * s / steps, 3) for n, s in seconds.items()}
    program = environment._program
    graph = "recorded" if program.recorded else program.unrecordable
    return found | {"together": round(1e3 * together / steps, 3), "reset": reset, "graph": graph}


def processes(make: Callable[[], Any], worlds: int, options: Any) -> float:
    """`AsyncVectorEnv` with a process for each core, which share the worlds."""
    count = min(worlds, options.processes)
    shares = [worlds // count + (i < worlds % count) for i in range(count)]
    if len(set(shares)) > 1:
        raise ValueError(f"{worlds} worlds cannot be shared evenly by {count} processes")
    env = gymnasium.vector.AsyncVectorEnv(
        [functools.partial(Several, make, share) for share in shares], context="spawn"
    )
    env.reset()
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(16)]
    chosen = iter(range(10**9))
    found = rate(
        lambda: env.step(actions[next(chosen) % 16]) and None,
        worlds,
        options.seconds,
        options.repeats,
    )
    env.close()
    return found


def measure(
    name: str, worlds: int, options: Any, rates: dict[str, Any], write: Callable[[], None]
) -> None:
    """All that is compared, for one task and number of worlds; each is written once it is there."""
    domain, task = name.split("-")
    jobs: dict[str, Callable[[], float]] = {
        "orbisim mujoco": functools.partial(ours, domain, task, worlds, "mujoco", options)
    }
    if options.warp:
        jobs["orbisim warp"] = functools.partial(ours, domain, task, worlds, "warp", options)
        jobs["orbisim warp, tensors"] = functools.partial(
            ours, domain, task, worlds, "warp", options, "torch"
        )
    if options.learned:
        jobs["orbisim learned, plain"] = lambda: ours(domain, task, worlds, plain(worlds), options)
        jobs["orbisim learned"] = functools.partial(ours, domain, task, worlds, "learned", options)
    if worlds <= options.most and not options.ours:
        make = functools.partial(_shimmy, domain, task)
        jobs["dm_control async"] = functools.partial(processes, make, worlds, options)
        like = functools.partial(_gymnasium, TASKS[name])
        jobs[f"gymnasium {TASKS[name]} async"] = functools.partial(processes, like, worlds, options)
    for label, job in jobs.items():
        if options.only is not None and label not in options.only:
            continue
        if options.limit and time.monotonic() - options.begun > options.limit:
            break
        try:
            rates[label] = job()
        except Exception as error:  # what one library cannot do must not lose the others
            rates[label] = {"failed": f"{type(error).__name__}: {str(error)[:200]}"}
        write()


def playground(options: Any) -> dict[str, Any]:
    """mujoco_playground's steps per second by task and worlds, in a process of its own."""
    tool = Path(__file__).with_name("bench_playground.py")
    tasks = [PLAYGROUND[name] for name in options.playground_tasks]
    worlds = [str(count) for count in options.playground_worlds]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "playground.json"
        words = [options.playground, tool, "--tasks", *tasks, "--worlds", *worlds, "--out", out]
        words += ["--seconds", str(options.seconds), "--repeats", str(options.repeats)]
        words += ["--impl", options.impl, "--contacts", str(options.contacts)]
        left = options.limit - (time.monotonic() - options.begun) if options.limit else None
        try:
            done = subprocess.run(words, stdout=subprocess.DEVNULL, timeout=left)
            ended = f"exit status {done.returncode}" if done.returncode else ""
        except subprocess.TimeoutExpired:
            ended = "out of time"
        found = dict(json.loads(out.read_text())) if out.exists() else {}
    return {**found, "failed": ended} if ended else found


def ratios(rates: dict[str, Any]) -> str:
    """Of the first to the others: all have the same processors."""
    measured = [(label, rate) for label, rate in rates.items() if isinstance(rate, float)]
    if not measured:
        return "nothing measured"
    (name, mine), *others = measured
    times = [f"{mine / rate:.1f} x {other}" for other, rate in others]
    return f"{name} is {', '.join(times)}" if times else name


def main() -> None:
    """Prints a line for each measurement, and writes all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="*", default=list(TASKS), choices=list(TASKS))
    parser.add_argument("--worlds", nargs="*", type=int, default=list(WORLDS))
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--processes", type=int, default=usable_cpus())
    parser.add_argument("--most", type=int, default=4096, help="worlds in processes")
    parser.add_argument("--warp", action="store_true")
    parser.add_argument(
        "--only", nargs="*", default=None, metavar="LABEL", help="e.g. 'orbisim warp, tensors'"
    )
    parser.add_argument(
        "--profile", type=int, default=0, metavar="STEPS", help="where the time of so many goes"
    )
    parser.add_argument("--learned", action="store_true", help="of cartpole, cheetah and walker")
    parser.add_argument("--ours", action="store_true", help="nothing of dm_control and gymnasium")
    parser.add_argument("--playground", default=None, help="a Python that has mujoco_playground")
    parser.add_argument("--playground-tasks", nargs="*", default=list(TASKS), choices=list(TASKS))
    parser.add_argument("--playground-worlds", nargs="*", type=int, default=[64, 4096])
    parser.add_argument("--impl", default="jax", help="of playground's MJX: jax or warp")
    parser.add_argument("--contacts", type=int, default=0, help="of a world; 0: playground's")
    parser.add_argument("--limit", type=float, default=0.0, help="s after which none is begun")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    _be_quiet()
    from_source.register()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    options.begun = time.monotonic()
    found: dict[str, Any] = {"cpus": usable_cpus(), "steps_per_s": {}}
    for worlds in options.worlds:
        for name in options.tasks:
            rates: dict[str, Any] = {}
            found["steps_per_s"].setdefault(name, {})[worlds] = rates
            measure(name, worlds, options, rates, lambda: _write(found, options.out))
            said = {n: f"{r:,.0f}" if isinstance(r, float) else r for n, r in rates.items()}
            print(name, worlds, said, flush=True)
            print("   ", ratios(rates), flush=True)
    if options.playground is not None:
        found["playground"] = playground(options)
        print(json.dumps(found["playground"]), flush=True)
        _write(found, options.out)


def _write(found: dict[str, Any], path: Path | None) -> None:
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
