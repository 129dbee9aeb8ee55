"""Caps that are turned before they are lifted: bottles, pens in a stand."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.model import (
    BASE,
    Grip,
    Joint,
    Mechanism,
    Operation,
    Part,
    detents,
    lock,
)
from orbisim.tasks.mechanisms.solids import box, cylinder, frustum


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """A bottle: sizes, way and angle of the thread, friction, clicks."""
    radius, height = between(rng, 0.026, 0.042), between(rng, 0.07, 0.12)
    neck, cap = between(rng, 0.01, 0.016), between(rng, 0.013, 0.024)
    shoulder, tall = between(rng, 0.015, 0.03), between(rng, 0.024, 0.034)
    cap = max(cap, neck + 0.002)
    body = Part(
        BASE,
        (
            cylinder(radius, height, (0, 0, height / 2)),
            frustum(radius, neck, shoulder, (0, 0, height + shoulder / 2)),
            cylinder(neck, tall, (0, 0, height + shoulder + tall / 2)),
        ),
        600.0,
        colour(rng),
    )
    top = height + shoulder + 0.004
    return capped("bottle", number, rng, body, top, cap, tall, (0.52, 0.0))


def capped(
    family: str,
    number: int,
    rng: np.random.Generator,
    body: Part,
    top: float,
    radius: float,
    tall: float,
    place: tuple[float, float],
) -> Mechanism:
    """A cap of a radius and a height on a body, from a height `top` up: turn, then lift."""
    way, opens, tight = either(rng), between(rng, 0.5, 1.1), radius / 0.02
    thread = Part("thread", (cylinder(radius * 0.6, tall * 0.6, (0, 0, tall * 0.4)),), 1000.0,
                  colour(rng))  # fmt: skip
    ribs = int(rng.integers(0, 5))
    solids = [cylinder(radius, tall, (0, 0, tall / 2))]
    for rib in range(ribs):
        angle = 2 * np.pi * rib / ribs
        out = radius * np.array([np.cos(angle), np.sin(angle)])
        solids.append(
            box((0.003, 0.003, tall * 0.8), (float(out[0]), float(out[1]), tall / 2), (0, 0, angle))
        )
    cap = Part("cap", tuple(solids), 900.0, colour(rng))
    turn = Joint(
        "turn", "hinge", BASE, "thread", (0, 0, top), (0, 0, way), 0.0, opens + 0.45,
        friction=tight * between(rng, 0.02, 0.08), damping=tight * between(rng, 0.005, 0.02),
        armature=1e-4,
    )  # fmt: skip
    lift = Joint(
        "lift", "slide", "thread", "cap", (0, 0, 0), (0, 0, 1), 0.0, 0.08,
        friction=between(rng, 0.3, 1.5), damping=between(rng, 1.0, 4.0), armature=0.2,
    )  # fmt: skip
    middle = max(tall / 2, tall - 0.022)
    turned = -way * (opens + 0.3) / 2  # so that the turn is symmetrical about straight ahead
    closing = (float(np.sin(turned)), float(np.cos(turned)), 0.0)
    grip = Grip("cap", (0, 0, middle), (0, 0, -1), closing, clearance=0.07)
    return Mechanism(
        family, number, (body, thread, cap), (turn, lift),
        (
            lock("lift", "turn", opens, width=0.004, force=500.0),
            detents("turn", tight * between(rng, 0.0, 0.03), between(rng, 0.2, 0.5)),
        ),
        (Operation(grip, (("turn", opens + 0.3), ("lift", 0.055)), release=False),),
        goal=("lift", 0.03), place=place,
        features={"radius": radius, "height": top, "way": way, "opens": opens},
    )  # fmt: skip
