"""Parts that several families have: levers, buttons, leaves on hinges."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour
from orbisim.tasks.mechanisms.model import Grip, Joint, Operation, Part
from orbisim.tasks.mechanisms.solids import Vector, box, cylinder

TIP = 0.009
"""From the tool's centre point to the tips of the fingers, m."""
_GAP = 0.003
"""Between the tips and what they are about to push, m."""
_TILT = 0.85
"""Of a hand that works on a face in front of it, down from the horizontal, rad: a Panda's wrist
does not bend far enough to point straight ahead near the table."""
AHEAD: Vector = (1.0, 0.0, 0.0)
ONWARD: Vector = (float(np.cos(_TILT)), 0.0, float(-np.sin(_TILT)))
"""Into a face that looks along -x, from above."""
UPWARD: Vector = (float(np.sin(_TILT)), 0.0, float(np.cos(_TILT)))
"""At right angles to it."""
DOWN: Vector = (0.0, 0.0, -1.0)


def lever(
    rng: np.random.Generator,
    on: str,
    pos: Vector,
    way: float,
    opens: float,
    along: Vector,
    *,
    spring: tuple[float, float] = (0.0, 0.0),
) -> tuple[Part, Joint, Grip]:
    """A lever on a face that looks along -x: part `lever`, joint `handle`, and where to hold it.

    Args:
      on: the part that has it. pos: of the pivot, on the face.
      way: 1 or -1, about x. opens: angle that releases, rad.
      along: unit vector from the pivot to the lever's end, y or z.
      spring: range of the stiffness that returns it, N*m/rad.
    """  # fmt: skip
    length, bar = between(rng, 0.08, 0.11), between(rng, 0.012, 0.018)
    stand, toward = between(rng, 0.055, 0.07), np.array(along)
    middle = toward * (length / 2 - bar)
    _, wide, tall = np.where(np.abs(toward) > 0.5, length, bar)
    part = Part(
        "lever",
        (
            cylinder(bar * 0.6, stand, (-stand / 2, 0, 0), "x"),
            box((bar, float(wide), float(tall)), (-stand, float(middle[1]), float(middle[2]))),
        ),
        2500.0,
        colour(rng),
    )  # fmt: skip
    joint = Joint(
        "handle", "hinge", on, "lever", pos, (way, 0, 0), 0.0, opens + 0.2,
        friction=between(rng, 0.01, 0.04), damping=0.01, stiffness=between(rng, *spring),
        armature=2e-4,
    )  # fmt: skip
    at = 0.75 * (length - bar) * toward
    across = UPWARD if abs(toward[1]) > 0.5 else (0.0, 1.0, 0.0)
    grip = Grip("lever", (-stand, float(at[1]), float(at[2])), ONWARD, across)
    return part, joint, grip


def button(
    rng: np.random.Generator, name: str, on: str, pos: Vector, into: Vector, *, springs: bool
) -> tuple[Part, Joint, Operation]:
    """A push button, and how to push it: part and joint have the name.

    Args:
      on: the part that has it. pos: of its centre, on the face. into: x or -z.
      springs: whether a spring returns it; otherwise friction keeps it where it was pushed.
    """
    radius, out = between(rng, 0.009, 0.014), between(rng, 0.012, 0.018)
    travel = between(rng, 0.006, 0.009)
    way = np.array(into)
    centre = way * -out / 2
    solid = cylinder(
        radius, out, (float(centre[0]), 0.0, float(centre[2])), "x" if into[0] else "z"
    )
    part = Part(name, (solid,), 1200.0, colour(rng))
    joint = Joint(
        name, "slide", on, name, pos, into, 0.0, travel,
        friction=0.3 if springs else between(rng, 1.0, 2.5), damping=2.0,
        stiffness=between(rng, 200.0, 500.0) if springs else 0.0, armature=0.05,
    )  # fmt: skip
    place, ahead = way * -(out + _GAP), bool(into[0])
    place = place - TIP * np.array(ONWARD if ahead else DOWN)
    closing = UPWARD if ahead else (0.0, 1.0, 0.0)  # the hand is long that way
    at = (float(place[0]), 0.0, float(place[2]))
    grip = Grip(name, at, ONWARD if ahead else DOWN, closing)
    push = Operation(grip, ((name, travel + _GAP + 0.006),), closed=False)
    return part, joint, push
