"""Actuators: MuJoCo's own, Newton's, and the drives of joints."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from orbisim.scene.usd import tables
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.chains import Element
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.drives import Drive
from orbisim.scene.usd.joints import SLIDE
from orbisim.scene.usd.registry import Registry
from orbisim.scene.usd.tables import Field
from orbisim.scene.usd.tree import Forest

_TRN = mujoco.mjtTrn
_GAIN, _BIAS, _DYN = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn


def _types(kind: Any, prefix: str, *names: str) -> tables.Read:
    return tables.one_of({name: getattr(kind, prefix + name.upper()) for name in names})


_FIELDS = (
    Field("mjc:actDim", "actdim", tables.integer),
    Field("mjc:actEarly", "actearly", tables.flag),
    Field("mjc:actLimited", "actlimited", tables.limited),
    Field("mjc:actRange", "actrange", tables.bounds),
    Field("mjc:biasPrm", "biasprm", tables.vector),
    Field("mjc:biasType", "biastype", _types(_BIAS, "mjBIAS_", "none", "affine", "muscle", "user")),
    Field("mjc:crankLength", "cranklength", tables.number),
    Field("mjc:ctrlLimited", "ctrllimited", tables.limited),
    Field("mjc:ctrlRange", "ctrlrange", tables.bounds),
    Field("mjc:dynPrm", "dynprm", tables.vector),
    Field("mjc:dynType", "dyntype",
          _types(_DYN, "mjDYN_", "none", "integrator", "filter", "filterexact", "muscle", "user")),
    Field("mjc:forceLimited", "forcelimited", tables.limited),
    Field("mjc:forceRange", "forcerange", tables.bounds),
    Field("mjc:gainPrm", "gainprm", tables.vector),
    Field("mjc:gainType", "gaintype",
          _types(_GAIN, "mjGAIN_", "fixed", "affine", "muscle", "user")),
    Field("mjc:gear", "gear", tables.vector),
    Field("mjc:group", "group", tables.integer),
    Field("mjc:inheritRange", "inheritrange", tables.number),
    Field("mjc:lengthRange", "lengthrange", tables.bounds),
)  # fmt: skip


class ActuatorBuilder:
    """Adds the actuators of one spec, in the stage's order.

    Attributes:
      driven: the drives that became actuators: name, degree of freedom, drive.
    """

    def __init__(self, context: Context, registry: Registry, forest: Forest) -> None:
        self._context = context
        self._registry = registry
        self._elements: dict[str, list[Element]] = {}
        for link in forest.links:
            for element in link.chain:
                self._elements.setdefault(element.joint.path, []).append(element)
        self.driven: list[tuple[mujoco.MjsActuator, str, Drive]] = []

    def add_all(self) -> None:
        """Adds all actuators."""
        for prim in self._context.prims.values():
            if prim.flat.type_name == "MjcActuator":
                self._add_native(prim)
            elif prim.flat.type_name == "NewtonActuator":
                self._add_newton(prim)
            for element in self._in_order(prim.path):
                if element.dof.drive is not None:
                    self._add_drive(element, element.dof.drive)

    def _in_order(self, path: str) -> list[Element]:
        """A joint's elements from body0 to body1."""
        chain = self._elements.get(path, [])
        return sorted(chain, key=lambda element: element.joint.dofs.index(element.dof))

    def _joint_name(self, element: Element) -> str:
        chain = self._elements[element.joint.path]
        return self._registry.joints[element.joint.path][chain.index(element)]

    def _add_native(self, prim: Prim) -> None:
        target = self._context.target(prim, "mjc:target")
        found = self._transmission(prim, target)
        if found is None:
            what = f"<{target}>" if target else "nothing"
            self._context.omit(prim.path, f"MjcActuator whose target is {what}", "left out")
            return
        kind, name = found
        actuator = self._registry.spec.add_actuator(
            name=self._registry.actuator_names(prim.flat.display_name or prim.flat.name)
        )
        actuator.trntype, actuator.target = kind, name
        for relationship, field in (("mjc:refSite", "refsite"), ("mjc:sliderSite", "slidersite")):
            site = self._context.target(prim, relationship)
            if site is not None:
                setattr(actuator, field, self._registry.sites.get(site, ""))
        tables.apply(_FIELDS, prim, actuator)

    def _transmission(self, prim: Prim, target: str | None) -> tuple[mujoco.mjtTrn, str] | None:
        registry = self._registry
        in_parent = prim.flag("mjc:jointInParent", False)
        if target is None:
            return None
        if registry.joints.get(target):
            kind = _TRN.mjTRN_JOINTINPARENT if in_parent else _TRN.mjTRN_JOINT
            return kind, registry.joints[target][0]
        if target in registry.tendons:
            return _TRN.mjTRN_TENDON, registry.tendons[target]
        if target in registry.sites:
            slider = prim.flat.relationships.get("mjc:sliderSite")
            return (_TRN.mjTRN_SLIDERCRANK if slider else _TRN.mjTRN_SITE), registry.sites[target]
        if target in registry.bodies:
            return _TRN.mjTRN_BODY, registry.bodies[target]
        return None

    def _add_newton(self, prim: Prim) -> None:
        """A PD controller; other control laws have no counterpart here."""
        target = self._context.target(prim, "newton:targets")
        chain = self._elements.get(target or "", [])
        if not chain or not prim.has("NewtonPDControlAPI"):
            law = next((s for s in prim.flat.schemas if "Control" in s), "no control law")
            self._context.omit(prim.path, f"NewtonActuator with {law}", "left out")
            return
        for schema in prim.flat.schemas:
            if "Clamping" in schema and schema != "NewtonMaxEffortClampingAPI":
                self._context.omit(prim.path, schema, "its force is not clamped by it")
        units = self._context.units
        angular = chain[0].dof.kind != SLIDE
        force, unit = (units.inertia, 1.0) if angular else (units.force, units.length)
        effort = prim.number("newton:maxEffort", force, infinite=True)
        drive = Drive(
            prim=prim,
            stiffness=prim.number("newton:kp", force / unit) or 0.0,
            damping=prim.number("newton:kd", force / unit) or 0.0,
            max_force=np.inf if effort is None else effort,
            constant=prim.number("newton:constEffort", force) or 0.0,
            delay=int(prim.number("newton:delaySteps") or 1)
            if prim.has("NewtonActuatorDelayAPI")
            else 0,
        )
        self._add_drive(chain[0], drive)

    def _add_drive(self, element: Element, drive: Drive) -> None:
        """A drive whose control is its target: position, velocity, or force if it has no gains."""
        joint = self._joint_name(element)
        wanted = joint if drive.prim is element.joint.prim else drive.prim.flat.name
        actuator = self._registry.spec.add_actuator(name=self._registry.actuator_names(wanted))
        actuator.trntype, actuator.target = _TRN.mjTRN_JOINT, joint
        set_gains(actuator, drive, drive.stiffness, drive.damping)
        if np.isfinite(drive.max_force):
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = [-max(drive.max_force, 1e-12), max(drive.max_force, 1e-12)]
        if drive.delay:
            actuator.nsample = drive.delay + 1
            actuator.delay = drive.delay * self._registry.spec.option.timestep
        self.driven.append((actuator, joint, drive))


def set_gains(actuator: mujoco.MjsActuator, drive: Drive, stiffness: float, damping: float) -> None:
    """Makes an actuator exert its drive's force for `ctrl` in place of the drive's target."""
    gain, bias = np.zeros(len(actuator.gainprm)), np.zeros(len(actuator.biasprm))
    bias[:3] = drive.constant, -stiffness, -damping
    if stiffness > 0:
        gain[0] = stiffness
        bias[0] += damping * drive.target_velocity
    else:
        gain[0] = damping if damping > 0 else 1.0
    actuator.gaintype, actuator.gainprm = _GAIN.mjGAIN_FIXED, gain
    actuator.biastype, actuator.biasprm = _BIAS.mjBIAS_AFFINE, bias


def resting_control(drive: Drive) -> float:
    """The control at which a drive does what the stage says."""
    if drive.stiffness > 0:
        return drive.target
    return drive.target_velocity if drive.damping > 0 else 0.0
