"""Environment steps per second of mujoco_playground's dm_control suite; `bench_vector.py` runs it.

    PLAYGROUND/bin/python tools/bench_playground.py --tasks CartpoleSwingup --worlds 64

In an environment of its own (`python -m venv PLAYGROUND && PLAYGROUND/bin/pip install playground`):
nothing of OrbiSim is imported. Its own training wrapper makes worlds, episodes of 1,000 steps and
autoreset; random actions, several steps in one compiled call. Compilation is not counted. Prints
one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jax
import mujoco
from mujoco_playground import registry, wrapper


def rate(task: str, worlds: int, impl: str, steps: int, seconds: float, repeats: int) -> float:
    """The best number of environment steps per second."""
    config = registry.get_default_config(task)
    config.impl = impl
    env = wrapper.wrap_for_brax_training(
        registry.load(task, config=config), episode_length=1000, action_repeat=1
    )

    def several(carry: Any, key: Any) -> tuple[Any, Any]:
        action = jax.random.uniform(key, (worlds, env.action_size), minval=-1.0, maxval=1.0)
        after = env.step(carry, action)
        return after, after.reward

    @jax.jit
    def run(state: Any, key: Any) -> Any:
        state, reward = jax.lax.scan(several, state, jax.random.split(key, steps))
        return state, reward.sum()

    # raw keys: its wrapper takes the last axis of a key for its bits
    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), worlds))
    key = jax.random.PRNGKey(1)
    state, total = jax.block_until_ready(run(state, key))
    best = 0.0
    for _ in range(repeats):
        begun, count = time.perf_counter(), 0
        while time.perf_counter() - begun < seconds:
            key, used = jax.random.split(key)
            state, total = jax.block_until_ready(run(state, used))
            count += steps
        best = max(best, count * worlds / (time.perf_counter() - begun))
    assert bool(jax.numpy.isfinite(total))
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tasks", nargs="+", required=True)
    parser.add_argument("--worlds", nargs="+", type=int, required=True)
    parser.add_argument("--impl", default="jax", help="of MJX: jax, or warp on a GPU")
    parser.add_argument("--steps", type=int, default=16, help="in one compiled call")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, help="written after each measurement")
    options = parser.parse_args()
    versions = {"jax": jax.__version__, "mujoco": mujoco.__version__}
    said: dict[str, Any] = {"impl": options.impl, "device": str(jax.devices()[0]), **versions}
    found: dict[str, Any] = {}
    for task in options.tasks:
        for worlds in options.worlds:
            begun = time.perf_counter()
            best = rate(task, worlds, options.impl, options.steps, options.seconds, options.repeats)
            spent = time.perf_counter() - begun
            found.setdefault(task, {})[worlds] = {"steps_per_s": best, "seconds": round(spent, 1)}
            if options.out is not None:
                options.out.write_text(json.dumps({**said, "found": found}, indent=1))
    print(json.dumps({**said, "found": found}))


if __name__ == "__main__":
    main()
