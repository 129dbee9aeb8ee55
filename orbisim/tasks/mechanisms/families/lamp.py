"""A lamp: its knob is pushed in some and turned in others, and looks the same."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.families.fittings import DOWN, TIP
from orbisim.tasks.mechanisms.model import (
    BASE,
    Grip,
    Joint,
    Mechanism,
    Operation,
    Part,
    catch,
    detents,
)
from orbisim.tasks.mechanisms.solids import cylinder, frustum


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """An instance: sizes, whether the knob is pushed or turned, spring, clicks, friction."""
    base, high = between(rng, 0.075, 0.1), between(rng, 0.018, 0.03)
    stem, pushed = between(rng, 0.22, 0.3), bool(rng.random() < 0.5)
    shade = between(rng, 0.045, 0.06)
    housing = Part(
        BASE,
        (
            cylinder(base, high, (0, 0, high / 2)),
            cylinder(0.008, stem, (base - 0.015, 0, high + stem / 2)),
            frustum(shade, 0.6 * shade, 0.08, (base + 0.02, 0, high + stem)),
        ),
        900.0,
        colour(rng),
    )
    radius, tall = between(rng, 0.012, 0.02), between(rng, 0.022, 0.032)
    way, opens = either(rng), between(rng, 0.5, 1.1)
    plunger = Part("plunger", (cylinder(0.5 * radius, 0.01, (0, 0, -0.006)),), 1500.0, colour(rng))
    knob = Part("knob", (cylinder(radius, tall, (0, 0, tall / 2)),), 1200.0, colour(rng))
    travel = between(rng, 0.006, 0.009)
    press = Joint(
        "press", "slide", BASE, "plunger", (-0.55 * base, 0, high + travel + 0.002), (0, 0, -1),
        0.0, travel, friction=0.3, damping=2.0, stiffness=between(rng, 150.0, 500.0), armature=0.05,
    )  # fmt: skip
    turn = Joint(
        "turn", "hinge", "plunger", "knob", (0, 0, 0), (0, 0, way), 0.0, opens + 0.55,
        friction=between(rng, 0.01, 0.05), damping=0.005, armature=1e-4,
    )  # fmt: skip
    closing = (float(np.sin(-way * opens / 2)), float(np.cos(way * opens / 2)), 0.0)
    hold = Grip("knob", (0, 0, tall - 0.008), DOWN, closing)
    above = Grip("knob", (0, 0, tall + TIP + 0.003), DOWN, (0, 1, 0))
    if pushed:
        effects = [catch("turn", 5.0, 10.0)]
        operation = Operation(above, (("press", travel + 0.01),), closed=False)
        goal = ("press", 0.6 * travel)
    else:
        effects = [
            catch("press", 300.0, 1.0),
            detents("turn", between(rng, 0.01, 0.06), between(rng, 0.25, 0.5)),
        ]
        operation = Operation(hold, (("turn", opens + 0.35),))
        goal = ("turn", opens)
    return Mechanism(
        "lamp", number, (housing, plunger, knob), (press, turn), tuple(effects), (operation,),
        goal=goal, place=(0.56, 0.0),
        features={"base": base, "pushed": float(pushed), "way": way, "opens": opens},
    )  # fmt: skip
