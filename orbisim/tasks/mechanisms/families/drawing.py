"""What the families draw from."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.solids import Vector


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform."""
    return float(rng.uniform(low, high))


def either(rng: np.random.Generator) -> float:
    """-1 or 1."""
    return float(rng.choice([-1.0, 1.0]))


def colour(rng: np.random.Generator) -> Vector:
    """Red, green, blue."""
    red, green, blue = (float(value) for value in rng.uniform(0.15, 0.9, 3))
    return red, green, blue
