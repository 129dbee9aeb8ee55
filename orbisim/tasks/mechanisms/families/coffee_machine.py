"""A coffee machine: the portafilter is turned by its handle, then comes down."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.families.fittings import DOWN
from orbisim.tasks.mechanisms.model import (
    BASE,
    Grip,
    Joint,
    Mechanism,
    Operation,
    Part,
    catch,
    lock,
)
from orbisim.tasks.mechanisms.solids import box, cylinder


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """An instance: sizes, way and angle of the bayonet, friction."""
    wide, deep, foot = between(rng, 0.16, 0.24), between(rng, 0.1, 0.14), between(rng, 0.015, 0.03)
    group, low = between(rng, 0.028, 0.036), between(rng, 0.14, 0.18)
    tall = low + between(rng, 0.06, 0.09)
    way, opens = either(rng), between(rng, 0.4, 0.8)
    over = group + 0.006
    housing = Part(
        BASE,
        (
            box((deep + 2 * over, wide, foot), (0.5 * deep, 0, foot / 2)),
            box((deep, wide, tall), (over + deep / 2, 0, tall / 2)),
            box((2 * over, wide * 0.6, tall - low - 0.02), (0, 0, (tall + low + 0.02) / 2)),
            cylinder(group, 0.02, (0, 0, low + 0.01)),
        ),
        700.0,
        colour(rng),
    )
    length, bar = between(rng, 0.09, 0.12), between(rng, 0.014, 0.02)
    aside = -way * (opens + 0.12) / 2  # so that the turn is symmetrical about straight ahead
    out = group + length / 2
    ring = Part("ring", (cylinder(group * 0.8, 0.006, (0, 0, 0.003)),), 1500.0, colour(rng))
    filter_ = Part(
        "portafilter",
        (
            cylinder(group, 0.03, (0, 0, -0.016)),
            box(
                (length, bar, bar),
                (-out * float(np.cos(aside)), -out * float(np.sin(aside)), -0.02),
                (0, 0, aside),
            ),
        ),
        1200.0,
        colour(rng),
    )
    turn = Joint(
        "turn", "hinge", BASE, "ring", (0, 0, low), (0, 0, way), 0.0, opens + 0.25,
        friction=between(rng, 0.05, 0.3), damping=between(rng, 0.01, 0.05), armature=1e-3,
    )  # fmt: skip
    lower = Joint(
        "lower", "slide", "ring", "portafilter", (0, 0, 0), (0, 0, -1), 0.0, 0.06,
        friction=between(rng, 2.0, 5.0), damping=between(rng, 2.0, 8.0), armature=0.2,
    )  # fmt: skip
    at = group + length - 0.03
    place = (-at * float(np.cos(aside)), -at * float(np.sin(aside)), -0.02)
    grip = Grip("portafilter", place, DOWN, (float(-np.sin(aside)), float(np.cos(aside)), 0.0))
    return Mechanism(
        "coffee_machine", number, (housing, ring, filter_), (turn, lower),
        (
            lock("lower", "turn", opens, width=0.004, force=600.0),
            catch("turn", between(rng, 0.0, 0.3), 0.04),
        ),
        (Operation(grip, (("turn", opens + 0.12), ("lower", 0.045)), release=False),),
        goal=("lower", 0.025), place=(0.58, 0.0),
        features={"group": group, "low": low, "way": way, "opens": opens},
    )  # fmt: skip
