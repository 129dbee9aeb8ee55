"""A stage's units and axes, and the factors to SI."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from orbisim.errors import InputError, SceneError
from orbisim.scene.usd.flat import FlatStage, FloatArray
from orbisim.scene.usd.pose import Placement, split

DEGREE = math.pi / 180
EARTH_GRAVITY = 9.81  # m/s^2
WATER = 1000.0  # kg/m^3, UsdPhysics' density where none is given

_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_MJ_ORIENTATION = {"Y": _Y_TO_Z, "Z": np.eye(4)}


@dataclasses.dataclass(frozen=True)
class Units:
    """Factors from stage units to SI.

    Attributes:
      length: m for one unit of distance.
      mass: kg for one unit of mass.
      up: "Y" or "Z".
    """

    length: float = 1.0
    mass: float = 1.0
    up: str = "Z"

    @property
    def density(self) -> float:
        """To kg/m^3."""
        return self.mass / self.length**3

    @property
    def inertia(self) -> float:
        """To kg m^2; also of torque to N m."""
        return self.mass * self.length**2

    @property
    def force(self) -> float:
        """To N."""
        return self.mass * self.length

    def place(self, matrix: FloatArray) -> Placement:
        """A prim's matrix (to the world, stage units) as a placement in m, z up."""
        world = _MJ_ORIENTATION[self.up] @ matrix
        scaled = world.copy()
        scaled[:3, :] *= self.length
        return split(scaled)

    def direction(self, vector: FloatArray) -> FloatArray:
        """A direction in the stage's world, z up."""
        return np.asarray(_MJ_ORIENTATION[self.up][:3, :3] @ vector)


def units_of(
    stage: FlatStage, source: str, meters_per_unit: float | None, up_axis: str | None
) -> tuple[Units, list[str]]:
    """The stage's units, and warnings about those that had to be assumed.

    Raises:
      InputError: an option is not a unit or axis.
      SceneError: a unit in the file is not a positive number.
    """
    if meters_per_unit is not None and not 0 < meters_per_unit < math.inf:
        raise InputError(f"meters_per_unit must be a positive number; got {meters_per_unit!r}")
    if up_axis not in (None, "Y", "Z"):
        raise InputError(f"up_axis must be 'Y' or 'Z'; got {up_axis!r}")
    for name, value in (
        ("metersPerUnit", stage.meters_per_unit),
        ("kilogramsPerUnit", stage.kilograms_per_unit),
    ):
        if value is not None and not 0 < value < math.inf:
            raise SceneError(source, f"{name} is {value}; expected a positive number")
    warnings = []
    if meters_per_unit is None and stage.meters_per_unit is None:
        warnings.append(
            "metersPerUnit is not authored: lengths are taken as centimetres, USD's fallback "
            "(say meters_per_unit=1.0 if they are metres)"
        )
    if up_axis is None and not stage.up_axis:
        warnings.append(
            "upAxis is not authored: y is taken as up, USD's fallback (say up_axis='Z' otherwise)"
        )
    length = meters_per_unit or stage.meters_per_unit or 0.01
    mass = stage.kilograms_per_unit or 1.0
    return Units(length, mass, up_axis or stage.up_axis or "Y"), warnings
