"""A microwave: a button releases the door, which springs ajar and is pulled open."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.cabinet import Cabinet, cabinet
from orbisim.tasks.mechanisms.families.drawing import between, colour
from orbisim.tasks.mechanisms.families.fittings import AHEAD, ONWARD, button
from orbisim.tasks.mechanisms.model import BASE, Grip, Joint, Mechanism, Operation, Part, lock
from orbisim.tasks.mechanisms.solids import box


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """An instance: sizes, side of the hinge, spring of the door and of the button."""
    made: Cabinet = cabinet(rng, panel=between(rng, 0.06, 0.075), wall=between(rng, 0.012, 0.018))
    stand, tall = between(rng, 0.04, 0.055), between(rng, 0.5, 0.75) * made.height
    bar = between(rng, 0.012, 0.018)
    edge = -made.side * (made.leaf - 0.03)
    solids = [
        box((made.thick, made.leaf, made.height), (0, -made.side * made.leaf / 2, 0)),
        box((bar, bar, tall), (-made.thick / 2 - stand, edge, 0)),
    ]
    for end in (-1, 1):
        solids.append(
            box((stand, bar, bar), (-made.thick / 2 - stand / 2, edge, end * (tall - bar) / 2))
        )
    door = Part("door", tuple(solids), 500.0, colour(rng))
    hinge = Joint(
        "hinge", "hinge", BASE, "door", made.hinge, (0, 0, -made.side), 0.0, 1.6,
        friction=between(rng, 0.01, 0.04), damping=between(rng, 0.03, 0.1),
        stiffness=between(rng, 0.5, 0.9), rest=between(rng, 0.12, 0.25),
    )  # fmt: skip
    knob, press, push = button(
        rng, "button", BASE, (made.front, made.panel, made.middle + 0.3 * made.height), AHEAD,
        springs=True,
    )  # fmt: skip
    threshold = 0.6 * press.upper
    grip = Grip("door", (-made.thick / 2 - stand, edge, 0.0), ONWARD, (0, 1, 0))
    return Mechanism(
        "microwave", number, (made.housing, door, knob), (hinge, press),
        (lock("hinge", "button", threshold, width=0.02, force=300.0),),
        (push, Operation(grip, (("hinge", 0.8),), release=False)),
        goal=("hinge", 0.5), place=(0.67 + made.depth / 2, 0.0),
        features={"leaf": made.leaf, "height": made.height, "side": made.side},
    )  # fmt: skip
