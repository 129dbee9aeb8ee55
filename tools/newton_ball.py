"""Newton's own `diffsim_ball`: gradient descent on the initial velocity, and where one ends.

    PYTHON tools/newton_ball.py VX VY VZ [--iterations 60] [--rate 0.8]

PYTHON needs the package newton (1.8.0) and nothing of OrbiSim. Prints one line of JSON: the squared
distance (m^2) from the target at which Newton's simulation ends from the given velocity (m/s), and
what its own gradient descent from the example's start finds.
"""

from __future__ import annotations

import argparse
import json
import time
import types
from typing import Any


def main() -> None:
    """Simulates and descends."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("velocity", nargs=3, type=float)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--rate", type=float, default=0.8)
    options = parser.parse_args()
    import newton.viewer
    from newton.examples.diffsim.example_diffsim_ball import Example

    arguments = types.SimpleNamespace(verbose=False)
    example = Example(newton.viewer.ViewerNull(num_frames=1), arguments)
    given = loss(example, options.velocity)
    example = Example(newton.viewer.ViewerNull(num_frames=1), arguments)
    example.train_rate = options.rate
    began, history = time.perf_counter(), []
    for _ in range(options.iterations):
        velocity = example.states[0].particle_qd.numpy()[0].tolist()
        example.step()
        history.append((float(example.loss_history[-1]), velocity))
    seconds = time.perf_counter() - began
    best, chosen = min(history)
    found = {
        "given_loss": given,
        "given_miss_mm": given**0.5 * 1e3,
        "descent": {
            "loss": best,
            "miss_mm": best**0.5 * 1e3,
            "velocity": chosen,
            "seconds": seconds,
            "losses": [value for value, _ in history],
        },
    }
    print(json.dumps(found))


def loss(example: Any, velocity: list[float]) -> float:
    """Squared distance from the target after Newton's own simulation."""
    example.states[0].particle_qd.assign([velocity])
    return float(example.forward().numpy()[0])


if __name__ == "__main__":
    main()
