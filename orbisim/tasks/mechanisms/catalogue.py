"""Families by name, and their instances."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping

import numpy as np

from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks.mechanisms.families import (
    bottle,
    coffee_machine,
    door,
    lamp,
    microwave,
    pen,
    pressure_cooker,
    safe,
    window,
)
from orbisim.tasks.mechanisms.model import Mechanism

FAMILIES: Mapping[str, Callable[[int, np.random.Generator], Mechanism]] = {
    "bottle": bottle.make,
    "coffee_machine": coffee_machine.make,
    "door": door.make,
    "lamp": lamp.make,
    "microwave": microwave.make,
    "pen": pen.make,
    "pressure_cooker": pressure_cooker.make,
    "safe": safe.make,
    "window": window.make,
}
INSTANCES = 24
"""Instances of a family that data are collected from."""
HELD_OUT = 4
"""The last ones of them are not trained on."""


def make(family: str, number: int) -> Mechanism:
    """An instance of a family; the same arguments give the same instance.

    Raises:
      UnknownNameError: there is no such family.
      InputError: the number is below 0.
    """
    if family not in FAMILIES:
        raise UnknownNameError("family of mechanisms", family, FAMILIES)
    if number < 0:
        raise InputError(f"instances are numbered from 0; got {number}")
    rng = np.random.default_rng([zlib.crc32(family.encode()), number])
    return FAMILIES[family](number, rng)
