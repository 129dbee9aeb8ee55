"""Adds joints to the bodies of a spec, with what else MuJoCo, Newton and PhysX say about them."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from orbisim.scene.usd import tables
from orbisim.scene.usd.chains import Element
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.joints import BALL, HINGE, SLIDE
from orbisim.scene.usd.names import NameBook
from orbisim.scene.usd.registry import Registry
from orbisim.scene.usd.tables import Field
from orbisim.scene.usd.tree import Link
from orbisim.scene.usd.units import DEGREE

_JOINT = mujoco.mjtJoint
_TYPES = {HINGE: _JOINT.mjJNT_HINGE, SLIDE: _JOINT.mjJNT_SLIDE, BALL: _JOINT.mjJNT_BALL}

_FIELDS = (
    Field("mjc:armature", "armature", tables.number),
    Field("mjc:frictionloss", "frictionloss", tables.number),
    Field("mjc:group", "group", tables.integer),
    Field("mjc:margin", "margin", tables.number),
    Field("mjc:actuatorfrclimited", "actfrclimited", tables.limited),
    Field("mjc:actuatorfrcrange", "actfrcrange", tables.bounds),
    Field("mjc:actuatorgravcomp", "actgravcomp", tables.flag),
    Field("mjc:solimpfriction", "solimp_friction", tables.vector),
    Field("mjc:solimplimit", "solimp_limit", tables.vector),
    Field("mjc:solreffriction", "solref_friction", tables.vector),
    Field("mjc:solreflimit", "solref_limit", tables.vector),
    Field("mjc:springdamper", "springdamper", tables.vector),
)


class JointBuilder:
    """Turns the chains of links into joints of one spec."""

    def __init__(self, context: Context, registry: Registry, names: Mapping[str, str]) -> None:
        self._context = context
        self._registry = registry
        self._names = names
        self._book = NameBook(names.values())

    def add(self, child: mujoco.MjsBody, link: Link) -> None:
        """Adds a link's joints to its body."""
        if link.floats:
            child.add_freejoint(name=self._book(child.name))
        counts = {joint.path: len(joint.dofs) for joint in link.joints}
        for joint in link.joints:
            self._registry.joints[joint.path] = []
        for element in link.chain:
            name = self._names[element.joint.path]
            if counts[element.joint.path] > 1:
                name = self._book(f"{name}_{element.dof.token}")
            self._add_one(child, element, name)
            self._registry.joints[element.joint.path].append(name)

    def _add_one(self, child: mujoco.MjsBody, element: Element, name: str) -> None:
        kind = _TYPES[element.dof.kind]
        joint = child.add_joint(name=name, type=kind)
        joint.pos, joint.axis = element.anchor, element.axis
        joint.ref = element.ref
        if element.dof.range is not None:
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.range = [*element.dof.range]
        else:
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        self._set_passive(joint, element)
        tables.apply(_FIELDS, element.joint.prim, joint)
        self._registry.joint_types[name] = kind

    def _set_passive(self, joint: mujoco.MjsJoint, element: Element) -> None:
        """Springs, damping, friction and rotor inertia, each in its schema's units."""
        prim, units = element.joint.prim, self._context.units
        angular = element.dof.kind != SLIDE
        inertia = units.inertia if angular else units.mass
        force = units.inertia if angular else units.force
        damping = units.inertia / DEGREE if angular else units.mass
        angle = self._context.mjc_angle if angular else 1.0
        joint.armature = (
            prim.number("newton:armature", inertia)
            or prim.number("physxJoint:armature", inertia)
            or 0.0
        )
        joint.frictionloss = prim.number("newton:friction", force) or 0.0
        viscous, own = prim.number("newton:damping", damping), prim.number("mjc:damping")
        joint.damping = _linear(own if own is not None else viscous or 0.0)
        joint.stiffness = _linear(prim.number("mjc:stiffness") or 0.0)
        joint.ref += prim.number("mjc:ref", angle) or 0.0
        joint.springref = prim.number("mjc:springref", angle) or 0.0
        limit = prim.number("newton:velocityLimit", infinite=True)
        if limit is not None and np.isfinite(limit):
            self._context.omit(prim.path, "newton:velocityLimit", "velocities are not limited")


def _linear(value: float) -> list[float]:
    """MuJoCo's polynomial coefficients with only the linear one."""
    return [value, 0.0, 0.0]
