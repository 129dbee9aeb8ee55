"""A box that is open in front, with a panel beside the opening: of microwaves and safes."""

from __future__ import annotations

import dataclasses

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.model import BASE, Part
from orbisim.tasks.mechanisms.solids import Vector, box


@dataclasses.dataclass(frozen=True)
class Cabinet:
    """A housing and where its door goes.

    Attributes:
      side: 1 or -1, of the hinge, along y. leaf, height, thick: of the door, m.
      front: x of the face, m. hinge: in the middle of the door's edge. panel: y of the panel's
        middle. middle: z of the door's middle. depth: m.
    """

    housing: Part
    side: float
    leaf: float
    height: float
    thick: float
    front: float
    hinge: Vector
    panel: float
    middle: float
    depth: float


def cabinet(rng: np.random.Generator, panel: float, wall: float, raised: float = 0.0) -> Cabinet:
    """Draws the sizes.

    Args:
      panel: width of the panel beside the door. wall: thickness. raised: of its foot; all in m.
    """
    leaf, height, depth = (
        between(rng, 0.2, 0.25),
        between(rng, 0.18, 0.24),
        between(rng, 0.16, 0.22),
    )
    side, thick, foot = either(rng), between(rng, 0.016, 0.024), raised + between(rng, 0.07, 0.1)
    whole = leaf + panel + 2 * wall
    middle = foot + wall + height / 2
    tall = height + 2 * wall
    front = -depth / 2
    edge = side * whole / 2  # of the housing, on the side of the hinge
    solids = (
        box((depth, whole, foot), (0, 0, foot / 2)),
        box((depth, whole, wall), (0, 0, foot + wall / 2)),
        box((depth, whole, wall), (0, 0, foot + tall - wall / 2)),
        box((wall, whole, height), (depth / 2 - wall / 2, 0, middle)),
        box((depth, wall, height), (0, edge - side * wall / 2, middle)),
        box((depth, panel + wall, height), (0, -edge + side * (panel + wall) / 2, middle)),
    )
    return Cabinet(
        housing=Part(BASE, solids, 600.0, colour(rng)),
        side=side, leaf=leaf, height=height, thick=thick, front=front - 0.002,
        hinge=(front - thick / 2 - 0.002, edge - side * wall, middle),
        panel=-edge + side * (panel + wall) / 2, middle=middle, depth=depth,
    )  # fmt: skip
