"""Environment steps per second of mujoco_playground's dm_control suite; `bench_vector.py` runs it.

    PLAYGROUND/bin/python tools/bench_playground.py --tasks CartpoleSwingup --worlds 64

In an environment of its own (`python -m venv PLAYGROUND && PLAYGROUND/bin/pip install playground`):
nothing of OrbiSim is imported. Its own training wrapper makes worlds, episodes of 1,000 steps and
autoreset; random actions, several steps in one compiled call. Compilation is not counted. Prints a
line for each task as soon as it is measured, and one JSON object at the end.

A world whose reward is not a number has diverged: playground's wrapper begins it anew, and it is
counted. So are, with `--impl warp`, worlds whose contacts did not fit: playground gives all worlds
together so many (200,000 for the humanoid), and what exceeds them is left out of the physics;
`--contacts` gives so many to each world instead.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import mujoco

try:
    import jax
    from mujoco_playground import registry, wrapper
except ImportError as error:  # --help needs neither
    MISSING = f"{error}; run it in an environment with `pip install playground`"
else:
    MISSING = ""


def load(task: str, worlds: int, options: Any) -> Any:
    """An environment that is silent about iterations of the solver: a line a step fills a disk."""
    config = registry.get_default_config(task)
    config.impl = options.impl
    if options.contacts:
        config.naconmax = options.contacts * worlds
    env = registry.load(task, config=config)
    if options.impl == "warp":
        env._mjx_model = env._mjx_model.tree_replace({"opt._impl.warn_overflow": 0})
    return env


def measure(task: str, worlds: int, options: Any) -> dict[str, Any]:
    """The best number of environment steps per second, and what went wrong in all of them."""
    begun_all = time.perf_counter()
    env = wrapper.wrap_for_brax_training(
        load(task, worlds, options), episode_length=1000, action_repeat=1
    )

    def several(carry: Any, key: Any) -> tuple[Any, Any]:
        action = jax.random.uniform(key, (worlds, env.action_size), minval=-1.0, maxval=1.0)
        after = env.step(carry, action)
        return after, (~jax.numpy.isfinite(after.reward)).sum()

    @jax.jit
    def run(state: Any, key: Any) -> Any:
        state, lost = jax.lax.scan(several, state, jax.random.split(key, options.steps))
        return state, lost.sum()

    # raw keys: its wrapper takes the last axis of a key for its bits
    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), worlds))
    key = jax.random.PRNGKey(1)
    state, lost = jax.block_until_ready(run(state, key))
    best, diverged, total = 0.0, int(lost), options.steps
    for _ in range(options.repeats):
        begun, count, losses = time.perf_counter(), 0, []
        while time.perf_counter() - begun < options.seconds:
            key, used = jax.random.split(key)
            state, lost = jax.block_until_ready(run(state, used))
            losses.append(lost)
            count += options.steps
        best = max(best, count * worlds / (time.perf_counter() - begun))
        diverged, total = diverged + sum(map(int, losses)), total + count
    found = {"steps_per_s": best, "diverged": diverged, "steps": total * worlds}
    if options.impl == "warp":
        found["overflowed"] = overflowed(state)
    return {**found, "seconds": round(time.perf_counter() - begun_all, 1)}


def overflowed(state: Any) -> int:
    """Worlds whose contacts or constraints did not fit into MuJoCo-Warp's buffers."""
    from mujoco.mjx.third_party import mujoco_warp as mjw

    kinds = mjw.OverflowType
    parts = (kinds.NEFC, kinds.NJMAX_NNZ, kinds.BROADPHASE, kinds.NARROWPHASE)
    small = sum(int(kind) for kind in parts)
    return int(((jax.numpy.asarray(state.data._impl.overflow) & small) != 0).sum())


def main() -> None:
    """Measures one task after the other; what fails is said and does not end the others."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tasks", nargs="+", required=True)
    parser.add_argument("--worlds", nargs="+", type=int, required=True)
    parser.add_argument("--impl", default="jax", help="of MJX: jax, or warp on a GPU")
    parser.add_argument("--contacts", type=int, default=0, help="of each world; 0: playground's")
    parser.add_argument("--steps", type=int, default=16, help="in one compiled call")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, help="written after each measurement")
    options = parser.parse_args()
    if MISSING:
        parser.error(MISSING)
    versions = {"jax": jax.__version__, "mujoco": mujoco.__version__}
    said: dict[str, Any] = {"impl": options.impl, "device": str(jax.devices()[0]), **versions}
    found: dict[str, Any] = {}
    for task in options.tasks:
        for worlds in options.worlds:
            try:
                result = measure(task, worlds, options)
            except Exception as error:  # what one task cannot do must not lose the others
                result = {"failed": f"{type(error).__name__}: {str(error)[:200]}"}
            found.setdefault(task, {})[worlds] = result
            print(task, worlds, json.dumps(result), file=sys.stderr, flush=True)
            if options.out is not None:
                options.out.parent.mkdir(parents=True, exist_ok=True)
                options.out.write_text(json.dumps({**said, "found": found}, indent=1))
    print(json.dumps({**said, "found": found}))


if __name__ == "__main__":
    main()
