"""A pressure cooker: the lid is turned by its grip, then lifted; some have a valve before that."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.families.fittings import DOWN, button
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
    """An instance: sizes, way and angle of the bayonet, valve, friction."""
    radius, height = between(rng, 0.07, 0.1), between(rng, 0.08, 0.13)
    way, opens, valve = either(rng), between(rng, 0.4, 0.8), bool(rng.random() < 0.5)
    length, bar, rise = (
        between(rng, 0.05, 0.08),
        between(rng, 0.012, 0.02),
        between(rng, 0.02, 0.03),
    )
    pot = Part(
        BASE,
        (
            cylinder(radius, height, (0, 0, height / 2)),
            box((0.03, 2 * radius + 0.1, 0.015), (0, 0, 0.8 * height)),
        ),
        800.0,
        colour(rng),
    )
    rim = Part("rim", (cylinder(0.9 * radius, 0.004, (0, 0, 0.002)),), 1000.0, colour(rng))
    turned = -way * (opens + 0.12) / 2  # so that the turn is symmetrical about straight ahead
    lid = Part(
        "lid",
        (
            cylinder(radius + 0.004, 0.014, (0, 0, 0.007)),
            cylinder(bar * 0.7, rise, (0, 0, 0.014 + rise / 2)),
            box((length, bar, 0.022), (0, 0, 0.014 + rise + 0.011), (0, 0, turned)),
        ),
        700.0,
        colour(rng),
    )
    turn = Joint(
        "turn", "hinge", BASE, "rim", (0, 0, height), (0, 0, way), 0.0, opens + 0.25,
        friction=between(rng, 0.05, 0.3), damping=between(rng, 0.01, 0.05), armature=1e-3,
    )  # fmt: skip
    lift = Joint(
        "lift", "slide", "rim", "lid", (0, 0, 0.002), (0, 0, 1), 0.0, 0.1,
        friction=between(rng, 0.3, 1.5), damping=between(rng, 2.0, 6.0), armature=0.2,
    )  # fmt: skip
    closing = (float(-np.sin(turned)), float(np.cos(turned)), 0.0)
    grip = Grip("lid", (0, 0, 0.014 + rise + 0.011), DOWN, closing)
    parts, joints = [pot, rim, lid], [turn, lift]
    effects = [
        lock("lift", "turn", opens, width=0.004, force=600.0),
        catch("turn", between(rng, 0.0, 0.2), 0.04),
    ]
    operations = [Operation(grip, (("turn", opens + 0.12), ("lift", 0.06)), release=False)]
    if valve:
        away = length / 2 + 0.026
        place = (-away * float(np.cos(turned)), -away * float(np.sin(turned)), 0.014)
        knob, press, push = button(rng, "valve", "lid", place, DOWN, springs=False)
        parts.append(knob)
        joints.append(press)
        effects.append(lock("turn", "valve", 0.6 * press.upper, width=0.05, force=20.0))
        operations.insert(0, push)
    return Mechanism(
        "pressure_cooker", number, tuple(parts), tuple(joints), tuple(effects), tuple(operations),
        goal=("lift", 0.03), place=(0.53, 0.0),
        features={"radius": radius, "height": height, "way": way, "opens": opens,
                  "valve": float(valve)},
    )  # fmt: skip
