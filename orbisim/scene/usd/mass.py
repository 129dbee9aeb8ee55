"""Mass properties by UsdPhysics' rules of precedence.

A body's explicit mass overrides that of its colliders; mass overrides density; a density nearer
to the collider overrides one farther up, and any of them the material's; where nothing is said
the density is 1000 kg/m^3. What a body says about its centre of mass or inertia overrides what
its colliders amount to.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import mujoco
import numpy as np

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FloatArray
from orbisim.scene.usd.pose import Pose

_POINT_RADIUS = 0.1  # m, of the sphere that stands for a body without colliders


@dataclasses.dataclass(frozen=True)
class MassApi:
    """What a prim's mass schema says, in SI units and the prim's rigid frame; None if nothing.

    Attributes:
      mass: kg; 0 only in a stage made for MuJoCo, elsewhere 0 stands for nothing.
      density: kg/m^3.
      com: [3] centre of mass, m.
      inertia: [3, 3] about the centre of mass, kg m^2.
      principal: moments [3] and orientation [4], where `inertia` was given by these.
    """

    mass: float | None = None
    density: float | None = None
    com: FloatArray | None = None
    inertia: FloatArray | None = None
    principal: tuple[FloatArray, FloatArray] | None = None

    @property
    def shapes_inertia(self) -> bool:
        """Whether it says more about a collider than MuJoCo's geoms can carry."""
        return self.com is not None or self.inertia is not None


@dataclasses.dataclass(frozen=True)
class Inertial:
    """Mass properties of a body in its frame.

    Attributes:
      mass: kg.
      com: [3] m.
      inertia: [3, 3] about `com`, along the frame's axes, kg m^2.
    """

    mass: float
    com: FloatArray
    inertia: FloatArray

    def about(self, point: FloatArray) -> FloatArray:
        """[3, 3] inertia about another point (parallel axis theorem)."""
        arm = point - self.com
        return np.asarray(self.inertia + self.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm)))

    def moved(self, pose: Pose) -> Inertial:
        """The same in the frame in which this frame has the given pose."""
        rotation = pose.rotation
        return Inertial(self.mass, pose.apply(self.com), rotation @ self.inertia @ rotation.T)

    def scaled(self, mass: float) -> Inertial:
        """The same distribution with another total mass."""
        return Inertial(mass, self.com, self.inertia * (mass / self.mass))


def read_mass(context: Context, prim: Prim) -> MassApi:
    """Reads a prim's mass schema.

    Raises:
      SceneError: a mass, density or moment of inertia is negative.
    """
    if not prim.has("PhysicsMassAPI") and not prim.authored("newton:inertia"):
        return MassApi()
    units = context.units
    mass = _positive(prim, "physics:mass", units.mass)
    if mass == 0 and not context.for_mujoco:
        mass = None
    full = prim.numbers("newton:inertia", None, units.inertia)
    principal = _principal(context, prim)
    inertia = None
    if full is not None and len(full) == 6:
        xx, yy, zz, xy, xz, yz = full
        inertia, principal = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), None
    elif principal is not None:
        rotation = Pose(quat=principal[1]).rotation
        inertia = np.asarray(rotation @ np.diag(principal[0]) @ rotation.T)
    density = _positive(prim, "physics:density", units.density) or None
    return MassApi(mass, density, _centre(context, prim), inertia, principal)


def _positive(prim: Prim, name: str, factor: float) -> float | None:
    value = prim.number(name, factor)
    if value is not None and value < 0:
        raise prim.error(f"{name} is {value}; expected a positive number")
    return value


def _centre(context: Context, prim: Prim) -> FloatArray | None:
    com = prim.numbers("physics:centerOfMass", 3, infinite=True)
    if com is None or not np.isfinite(com).all():
        return None  # -inf is the schema's way of leaving it open
    return context.place(prim.path).point(com)


def _principal(context: Context, prim: Prim) -> tuple[FloatArray, FloatArray] | None:
    moments = prim.numbers("physics:diagonalInertia", 3, context.units.inertia)
    axes = prim.rotation("physics:principalAxes")
    if moments is None or not moments.any():
        return None
    if (moments < 0).any():
        raise prim.error(
            f"physics:diagonalInertia is {moments.tolist()}; moments of inertia are positive"
        )
    return _balanced(moments), axes


def _balanced(diagonal: FloatArray) -> FloatArray:
    """Moments that rounding to single precision put just outside of A + B >= C, put back."""
    largest = int(diagonal.argmax())
    others = diagonal.sum() - diagonal[largest]
    if others < diagonal[largest] <= others * (1 + 1e-6):
        diagonal = diagonal.copy()
        diagonal[largest] = others
    return diagonal


def total(parts: Iterable[Inertial]) -> Inertial | None:
    """Several parts as one; None if there is no mass."""
    parts = list(parts)
    mass = sum(part.mass for part in parts)
    if mass <= 0:
        return None
    com = sum((part.mass * part.com for part in parts), np.zeros(3)) / mass
    return Inertial(mass, com, sum((part.about(com) for part in parts), np.zeros((3, 3))))


def overridden(computed: Inertial | None, says: MassApi, default_mass: float) -> Inertial:
    """A body's mass properties from what its colliders amount to and what its schema says."""
    if computed is None:
        mass = says.mass or default_mass
        com = says.com if says.com is not None else np.zeros(3)
        point = np.eye(3) * (0.4 * mass * _POINT_RADIUS**2)
        return Inertial(mass, com, says.inertia if says.inertia is not None else point)
    if says.mass:
        computed = computed.scaled(says.mass)
    com = says.com if says.com is not None else computed.com
    inertia = says.inertia if says.inertia is not None else computed.about(com)
    return Inertial(computed.mass, com, inertia)


def inertial_of(model: mujoco.MjModel) -> Inertial | None:
    """Mass properties of the one body that a model has, as MuJoCo's compiler found them."""
    mass = float(model.body_mass[1])
    if mass <= 0:
        return None
    rotation = Pose(quat=model.body_iquat[1]).rotation
    inertia = rotation @ np.diag(model.body_inertia[1]) @ rotation.T
    return Inertial(mass, model.body_ipos[1].copy(), inertia)
