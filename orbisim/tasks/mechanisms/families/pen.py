"""A pen in a stand: its cap is turned, then pulled off."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.bottle import capped
from orbisim.tasks.mechanisms.families.drawing import between, colour
from orbisim.tasks.mechanisms.model import BASE, Mechanism, Part
from orbisim.tasks.mechanisms.solids import box, cylinder


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """An instance: sizes of pen, cap and stand, way and angle of the turn, friction."""
    wide, high = between(rng, 0.04, 0.07), between(rng, 0.025, 0.05)
    barrel, out = between(rng, 0.0055, 0.009), between(rng, 0.05, 0.09)
    stand = Part(
        BASE,
        (
            box((wide, wide, high), (0, 0, high / 2)),
            cylinder(barrel, out, (0, 0, high + out / 2)),
        ),
        700.0,
        colour(rng),
    )
    tall, radius = between(rng, 0.035, 0.055), barrel + between(rng, 0.0015, 0.003)
    return capped("pen", number, rng, stand, high + out - 0.02, radius, tall, (0.5, 0.0))
