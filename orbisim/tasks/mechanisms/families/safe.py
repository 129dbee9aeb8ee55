"""A safe: a switch frees the handle, the handle frees the door."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.cabinet import cabinet
from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.families.fittings import AHEAD, button, lever
from orbisim.tasks.mechanisms.model import BASE, Joint, Mechanism, Operation, Part, catch, lock
from orbisim.tasks.mechanisms.solids import box


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """An instance: sizes, side of the hinge, way and angle of the handle, friction."""
    made = cabinet(rng, panel=between(rng, 0.055, 0.07), wall=between(rng, 0.02, 0.03), raised=0.06)
    way, opens = either(rng), between(rng, 0.6, 1.1)
    solid = box((made.thick, made.leaf, made.height), (0, -made.side * made.leaf / 2, 0))
    door = Part("door", (solid,), 1500.0, colour(rng))
    hinge = Joint(
        "hinge", "hinge", BASE, "door", made.hinge, (0, 0, -made.side), 0.0, 1.4,
        friction=between(rng, 0.1, 0.4), damping=between(rng, 0.1, 0.4),
    )  # fmt: skip
    pivot = (-made.thick / 2, -made.side * (made.leaf - 0.05), between(rng, 0.0, 0.2) * made.height)
    handle, turn, grip = lever(rng, "door", pivot, way, opens, (0, made.side, 0))
    knob, press, push = button(
        rng, "switch", BASE, (made.front, made.panel, made.middle + 0.3 * made.height), AHEAD,
        springs=False,
    )  # fmt: skip
    return Mechanism(
        "safe", number, (made.housing, door, handle, knob), (hinge, turn, press),
        (
            lock("handle", "switch", 0.6 * press.upper, width=0.05, force=60.0),
            lock("hinge", "handle", opens, width=0.03, force=400.0),
            catch("handle", between(rng, 0.02, 0.15), 0.05),
        ),
        (push, Operation(grip, (("handle", opens + 0.12), ("hinge", 0.6)), release=False)),
        goal=("hinge", 0.35), place=(0.66 + made.depth / 2, 0.0), yaw=np.pi / 2,
        features={"leaf": made.leaf, "height": made.height, "side": made.side, "way": way,
                  "opens": opens},
    )  # fmt: skip
