"""A window: a handle that hangs down turns to a side, then the sash swings, tilts or slides."""

from __future__ import annotations

import dataclasses

import numpy as np

from orbisim.tasks.mechanisms.families.drawing import between, colour, either
from orbisim.tasks.mechanisms.families.fittings import lever
from orbisim.tasks.mechanisms.model import (
    BASE,
    Joint,
    Mechanism,
    Operation,
    Part,
    catch,
    lock,
)
from orbisim.tasks.mechanisms.solids import Solid, Vector, box

KINDS = ("swing", "tilt", "slide")


def make(number: int, rng: np.random.Generator) -> Mechanism:
    """An instance: how it opens, sizes, way that the handle turns, friction, clicks."""
    kind = str(rng.choice(KINDS))
    width, height = between(rng, 0.2, 0.26), between(rng, 0.24, 0.32)
    rail, thick, sill = between(rng, 0.022, 0.03), between(rng, 0.018, 0.026), 0.14
    side, way, opens = either(rng), either(rng), between(rng, 0.7, 1.2)
    sash = Part(
        "sash",
        (
            box((thick, rail, height), (0, width / 2 - rail / 2, 0)),
            box((thick, rail, height), (0, -width / 2 + rail / 2, 0)),
            box((thick, width - 2 * rail, rail), (0, 0, height / 2 - rail / 2)),
            box((thick, width - 2 * rail, rail), (0, 0, -height / 2 + rail / 2)),
            box((0.006, width - 2 * rail, height - 2 * rail)),
        ),
        600.0,
        colour(rng),
    )
    frame = Part(BASE, _frame(kind, width, height, sill, side), 700.0, colour(rng))
    middle = sill + height / 2 + 0.004
    where: dict[str, tuple[Vector, Vector, float]] = {
        "swing": ((0, side * width / 2, middle), (0, 0, -side), 1.3),
        "tilt": ((0, 0, sill + 0.004), (0, -1, 0), 0.6),
        "slide": ((0, 0, middle), (0, side, 0), 0.13),
    }
    pos, axis, upper = where[kind]
    turns = kind != "slide"
    offset: dict[str, Vector] = {
        "swing": (0, -side * width / 2, 0), "tilt": (0, 0, height / 2), "slide": (0, 0, 0)
    }  # fmt: skip
    sash = _moved(sash, offset[kind])
    swing = Joint(
        "sash", "hinge" if turns else "slide", BASE, "sash", pos, axis, 0.0, upper,
        friction=between(rng, 0.05, 0.3) if turns else between(rng, 0.5, 3.0),
        damping=between(rng, 0.1, 0.3) if turns else between(rng, 2.0, 8.0),
    )  # fmt: skip
    dx, dy, dz = offset[kind]
    stile = 0.0 if kind == "tilt" else -side * (width / 2 - rail / 2)
    high = height / 2 - rail / 2 if kind == "tilt" else 0.03
    handle, turn, grip = lever(
        rng, "sash", (-thick / 2 + dx, stile + dy, high + dz), way, opens, (0, 0, -1)
    )
    goes = {"swing": 0.6, "tilt": 0.4, "slide": 0.11}[kind]
    return Mechanism(
        "window", number, (frame, sash, handle), (swing, turn),
        (
            lock("sash", "handle", opens, width=0.03 if turns else 0.004, force=400.0),
            catch("handle", between(rng, 0.05, 0.3), 0.04),
        ),
        (Operation(grip, (("handle", opens + 0.12), ("sash", goes)), release=False),),
        goal=("sash", 0.6 * goes), place=(0.69, 0.0),
        features={
            "kind": float(KINDS.index(kind)), "width": width, "height": height, "side": side,
            "way": way, "opens": opens,
        },
    )  # fmt: skip


def _frame(kind: str, width: float, height: float, sill: float, side: float) -> tuple[Solid, ...]:
    post, gap = 0.03, 0.004
    left, right = width / 2 + gap, width / 2 + gap
    if kind == "slide":  # room to slide into
        left, right = (left + 0.14, right) if side > 0 else (left, right + 0.14)
    whole, middle = left + right + 2 * post, (left - right) / 2
    solids = [
        box((0.06, whole, sill), (0, middle, sill / 2)),
        box((0.05, whole, post), (0, middle, sill + height + 2 * gap + post / 2)),
        box((0.05, post, height + 2 * gap), (0, left + post / 2, sill + height / 2 + gap)),
        box((0.05, post, height + 2 * gap), (0, -right - post / 2, sill + height / 2 + gap)),
    ]
    return tuple(solids)


def _moved(part: Part, offset: Vector) -> Part:
    dx, dy, dz = offset
    solids = []
    for solid in part.solids:
        x, y, z = solid.pos
        solids.append(dataclasses.replace(solid, pos=(x + dx, y + dy, z + dz)))
    return dataclasses.replace(part, solids=tuple(solids))
