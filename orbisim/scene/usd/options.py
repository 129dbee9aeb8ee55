"""Gravity, solver options and compiler settings from the physics scene prim."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from orbisim.scene.usd import tables
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FloatArray
from orbisim.scene.usd.tables import Field
from orbisim.scene.usd.units import EARTH_GRAVITY

_NEWTON_RATE = 1000.0  # Hz, the schema's fallback
_DISABLE, _ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit


def _enum(kind: Any, prefix: str, *names: str) -> tables.Read:
    return tables.one_of({name: getattr(kind, prefix + name.upper()) for name in names})


_OPTIONS = (
    *(
        Field(f"mjc:option:{name}", name, tables.number)
        for name in (
            "timestep", "ccd_tolerance", "density", "impratio", "ls_tolerance",
            "noslip_tolerance", "o_margin", "tolerance", "viscosity",
        )
    ),
    *(
        Field(f"mjc:option:{name}", name, tables.integer)
        for name in (
            "iterations", "ccd_iterations", "ls_iterations", "noslip_iterations",
            "sdf_initpoints", "sdf_iterations",
        )
    ),
    *(
        Field(f"mjc:option:{name}", name, tables.vector)
        for name in ("magnetic", "wind", "o_friction", "o_solimp", "o_solref")
    ),
    Field("mjc:option:cone", "cone",
          _enum(mujoco.mjtCone, "mjCONE_", "pyramidal", "elliptic")),
    Field("mjc:option:integrator", "integrator",
          _enum(mujoco.mjtIntegrator, "mjINT_",
                "euler", "rk4", "implicit", "implicitfast", "discrete")),
    Field("mjc:option:jacobian", "jacobian",
          _enum(mujoco.mjtJacobian, "mjJAC_", "auto", "dense", "sparse")),
    Field("mjc:option:solver", "solver",
          _enum(mujoco.mjtSolver, "mjSOL_", "pgs", "cg", "newton")),
)  # fmt: skip

_COMPILER = (
    Field("mjc:compiler:alignFree", "alignfree", tables.flag),
    Field("mjc:compiler:autoLimits", "autolimits", tables.flag),
    Field("mjc:compiler:balanceInertia", "balanceinertia", tables.flag),
    Field("mjc:compiler:boundInertia", "boundinertia", tables.number),
    Field("mjc:compiler:boundMass", "boundmass", tables.number),
    Field("mjc:compiler:fitAABB", "fitaabb", tables.flag),
    Field("mjc:compiler:fuseStatic", "fusestatic", tables.flag),
    Field("mjc:compiler:saveInertial", "saveinertial", tables.flag),
    Field("mjc:compiler:setTotalMass", "settotalmass", tables.number),
    Field("mjc:compiler:useThread", "usethread", tables.flag),
)

_DISABLES = {
    "actuation": _DISABLE.mjDSBL_ACTUATION, "autoreset": _DISABLE.mjDSBL_AUTORESET,
    "clampctrl": _DISABLE.mjDSBL_CLAMPCTRL, "constraint": _DISABLE.mjDSBL_CONSTRAINT,
    "contact": _DISABLE.mjDSBL_CONTACT, "damper": _DISABLE.mjDSBL_DAMPER,
    "equality": _DISABLE.mjDSBL_EQUALITY, "eulerdamp": _DISABLE.mjDSBL_EULERDAMP,
    "filterparent": _DISABLE.mjDSBL_FILTERPARENT, "frictionloss": _DISABLE.mjDSBL_FRICTIONLOSS,
    "gravity": _DISABLE.mjDSBL_GRAVITY, "island": _DISABLE.mjDSBL_ISLAND,
    "limit": _DISABLE.mjDSBL_LIMIT, "midphase": _DISABLE.mjDSBL_MIDPHASE,
    "multiccd": _DISABLE.mjDSBL_MULTICCD, "nativeccd": _DISABLE.mjDSBL_NATIVECCD,
    "refsafe": _DISABLE.mjDSBL_REFSAFE, "sensor": _DISABLE.mjDSBL_SENSOR,
    "spring": _DISABLE.mjDSBL_SPRING, "warmstart": _DISABLE.mjDSBL_WARMSTART,
}  # fmt: skip
_ENABLES = {
    "energy": _ENABLE.mjENBL_ENERGY, "fwdinv": _ENABLE.mjENBL_FWDINV,
    "invdiscrete": _ENABLE.mjENBL_INVDISCRETE, "override": _ENABLE.mjENBL_OVERRIDE,
}  # fmt: skip


def set_options(context: Context, spec: mujoco.MjSpec) -> None:
    """Sets everything that holds for the whole scene."""
    spec.modelname = context.stage.name
    spec.compiler.degree = False
    scenes = context.of_type("PhysicsScene")
    if not scenes:
        context.warn(f"there is no PhysicsScene: gravity is {EARTH_GRAVITY} m/s^2 downwards")
        spec.option.gravity = [0, 0, -EARTH_GRAVITY]
        return
    for other in scenes[1:]:
        context.omit(other.path, "a further PhysicsScene", f"<{scenes[0].path}> holds for all")
    _set_from(context, scenes[0], spec)
    if context.for_mujoco and (context.units.length, context.units.mass) != (1.0, 1.0):
        context.warn("numbers in mjc: attributes are taken as SI, whatever the stage's units")


def _set_from(context: Context, prim: Prim, spec: mujoco.MjSpec) -> None:
    spec.option.gravity = _gravity(context, prim)
    rate = prim.number("newton:timeStepsPerSecond")
    if rate is None and prim.has("NewtonSceneAPI"):
        rate = _NEWTON_RATE
    if rate is not None:
        if rate <= 0:
            raise prim.error(f"newton:timeStepsPerSecond is {rate:g}; expected a positive number")
        spec.option.timestep = 1.0 / rate
    iterations = prim.number("newton:maxSolverIterations")
    if iterations is not None and iterations > 0:
        spec.option.iterations = int(iterations)
    tables.apply(_OPTIONS, prim, spec.option)
    if not 0 < spec.option.timestep < math.inf:
        raise prim.error(f"the time step is {spec.option.timestep}; expected a positive number")
    tables.apply(_COMPILER, prim, spec.compiler)
    low, high = (prim.number(f"mjc:compiler:inertiaGroupRange:{end}") for end in ("min", "max"))
    spec.compiler.inertiagrouprange = [int(low or 0), 5 if high is None else int(high)]
    _set_flags(prim, spec.option)


def _set_flags(prim: Prim, option: Any) -> None:
    for name, bit in _DISABLES.items():
        if not prim.flag(f"mjc:flag:{name}", True):
            option.disableflags |= int(bit)
    if not prim.flag("newton:gravityEnabled", True):
        option.disableflags |= int(_DISABLE.mjDSBL_GRAVITY)
    for name, bit in _ENABLES.items():
        if prim.flag(f"mjc:flag:{name}", False):
            option.enableflags |= int(bit)
    groups = prim.numbers("mjc:option:actuatorgroupdisable", None)
    for group in () if groups is None else groups:
        option.disableactuator |= 1 << int(group)


def _gravity(context: Context, prim: Prim) -> FloatArray:
    """[3] m/s^2; a zero direction means down, a negative magnitude that of the earth."""
    direction = prim.numbers("physics:gravityDirection", 3)
    magnitude = prim.number("physics:gravityMagnitude", context.units.length, infinite=True)
    if magnitude is None or magnitude < 0:
        magnitude = EARTH_GRAVITY
    if math.isinf(magnitude):
        raise prim.error("physics:gravityMagnitude is infinite")
    if direction is None or not direction.any():
        return np.array([0, 0, -magnitude])
    world = context.units.direction(direction)
    return np.asarray(world / np.linalg.norm(world) * magnitude)


def takes_inertia_from_geoms(context: Context) -> bool:
    """Whether MuJoCo's compiler setting makes geoms override authored inertias."""
    for prim in context.of_type("PhysicsScene"):
        choice = prim.choice("mjc:compiler:inertiaFromGeom", ("false", "true", "auto"), "auto")
        return choice == "true"
    return False


def prefer_implicit(context: Context, spec: mujoco.MjSpec) -> None:
    """Chooses the integrator that damps drives implicitly, unless the stage names one."""
    scenes = context.of_type("PhysicsScene")
    if context.for_mujoco or (scenes and scenes[0].authored("mjc:option:integrator")):
        return
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
