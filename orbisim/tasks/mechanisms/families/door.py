"""A door: a lever that turns one way or the other releases a leaf."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.families.fittings import lever
from orbisim.tasks.mechanisms.model import BASE, Joint, Mechanism, Operation, Part, lock
from orbisim.tasks.mechanisms.solids import box


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """An instance: sizes, side of the hinge, way that the lever turns, springs, friction."""
    width, height, step = between(rng, 0.22, 0.3), between(rng, 0.26, 0.34), 0.1
    thick, post = between(rng, 0.016, 0.026), between(rng, 0.02, 0.035)
    side, way, opens = either(rng), either(rng), between(rng, 0.45, 0.7)
    deep = thick + 0.004
    beside = width / 2 + post / 2 + 0.004
    frame = Part(
        BASE,
        (
            box((0.12, width + 2 * post + 0.04, step), (0, 0, step / 2)),
            box((deep, post, height + 0.01), (0, beside, step + height / 2)),
            box((deep, post, height + 0.01), (0, -beside, step + height / 2)),
            box((deep, width + 2 * post + 0.008, post), (0, 0, step + height + post / 2 + 0.008)),
        ),
        700.0,
        colour(rng),
    )
    leaf = Part(
        "leaf", (box((thick, width, height), (0, -side * width / 2, 0)),), 400.0, colour(rng)
    )
    hinge = Joint(
        "hinge", "hinge", BASE, "leaf", (0, side * width / 2, step + height / 2 + 0.004),
        (0, 0, -side), 0.0, 1.4, friction=between(rng, 0.02, 0.15), damping=between(rng, 0.02, 0.2),
    )  # fmt: skip
    pivot = (-thick / 2, -side * (width - 0.04), between(rng, 0.0, 0.1) * height)
    handle, turn, grip = lever(rng, "leaf", pivot, way, opens, (0, side, 0), spring=(0.2, 0.6))
    return Mechanism(
        "door", number, (frame, leaf, handle), (hinge, turn),
        (lock("hinge", "handle", opens, width=0.03, force=400.0),),
        (Operation(grip, (("handle", opens + 0.12), ("hinge", 0.55)), release=False),),
        goal=("hinge", 0.35), place=(0.74, 0.0), yaw=np.pi / 2,
        features={"width": width, "height": height, "side": side, "way": way, "opens": opens},
    )  # fmt: skip
