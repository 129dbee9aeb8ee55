"""URDF joints as MuJoCo joints, and mimics as equality constraints."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from orbisim.scene.reading import Unsupported
from orbisim.scene.urdf.assembly import Body
from orbisim.scene.urdf.model import WORLD, Array, Joint

_FREE = mujoco.mjtJoint.mjJNT_FREE
_BALL = mujoco.mjtJoint.mjJNT_BALL
_SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
_HINGE = mujoco.mjtJoint.mjJNT_HINGE

ONE_AXIS = ("revolute", "continuous", "prismatic")
"""Joints with one degree of freedom."""


class Joints:
    """Adds joints to bodies and remembers what they could not carry."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self.warnings: list[str] = []
        self.unsupported: list[Unsupported] = []
        self._fast: list[Joint] = []

    def add(self, target: mujoco.MjsBody, body: Body) -> None:
        """Adds what connects a body to its parent: nothing for a fixed joint."""
        joint = body.joint
        if joint is None or joint.type == "fixed":
            return
        made = _MAKERS[joint.type](target, body, joint)
        for element in made:
            element.damping[0] = joint.damping
            element.frictionloss = joint.friction
        self._limit(made[0], joint)
        self._bound_force(made[0], joint)
        if joint.velocity:
            self._fast.append(joint)

    def finish(self) -> None:
        """Lists what concerns many joints, one line for each kind."""
        if self._fast:
            more = f" and {len(self._fast) - 1} more" if len(self._fast) > 1 else ""
            self.unsupported.append(
                Unsupported(self._fast[0].label + more, "limit velocity", "speeds are not limited")
            )

    def mimic(self, joint: Joint, joints: Mapping[str, Joint]) -> None:
        """Ties a joint to the one that it mimics."""
        if joint.mimic is None:
            return
        leader = joints[joint.mimic.joint]
        for one in (joint, leader):
            if one.type not in (*ONE_AXIS, "fixed"):
                self._leave_out(joint, "mimic", f"{one.name!r} is {one.type}: the joint is free")
                return
        if joint.type == "fixed":
            self.warnings.append(f"{joint.label}: is fixed, so its mimic has no effect")
            return
        tie = self._spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name1=joint.name
        )
        if leader.type != "fixed":
            tie.name2 = leader.name
        coefficients = np.zeros(tie.data.size)
        coefficients[:2] = joint.mimic.offset, joint.mimic.multiplier
        tie.data = coefficients

    def _limit(self, element: mujoco.MjsJoint, joint: Joint) -> None:
        """Sets the range where the document gives one.

        As in MuJoCo's import, a range with one end, or from 0 to 0, is none, and a range counts
        whatever the type of the joint.
        """
        lower, upper = joint.lower, joint.upper
        element.limited = False
        if (lower is None) != (upper is None):
            self.warnings.append(f"{joint.label}: has one limit of two; left without limits")
        elif lower is None or upper is None or lower == upper == 0.0:
            if joint.type in ("revolute", "prismatic"):
                self.warnings.append(f"{joint.label}: has no limits, although its type needs them")
        elif element.type == _FREE or (element.type == _BALL and lower != 0.0):
            self._leave_out(joint, f"limits of a {joint.type} joint", "left without limits")
        elif lower == upper:
            self._leave_out(joint, f"equal limits of a {joint.type} joint", "left without limits")
        else:
            element.limited, element.range = True, (lower, upper)
            if joint.type not in ("revolute", "prismatic"):
                first = " of its first axis" if joint.type == "planar" else ""
                self.warnings.append(
                    f"{joint.label}: is {joint.type} and has limits; kept as limits{first}"
                )

    def _bound_force(self, element: mujoco.MjsJoint, joint: Joint) -> None:
        effort = abs(joint.effort or 0.0)
        if effort == 0.0:
            return
        if element.type in (_SLIDE, _HINGE):
            element.actfrclimited, element.actfrcrange = True, (-effort, effort)
        else:
            self._leave_out(
                joint, f"limit effort of a {joint.type} joint", "forces are not limited"
            )

    def _leave_out(self, joint: Joint, feature: str, consequence: str) -> None:
        self.unsupported.append(Unsupported(joint.label, feature, consequence))


def _hinge(target: mujoco.MjsBody, body: Body, joint: Joint) -> list[mujoco.MjsJoint]:
    return [target.add_joint(name=joint.name, type=_HINGE, axis=joint.axis)]


def _slide(target: mujoco.MjsBody, body: Body, joint: Joint) -> list[mujoco.MjsJoint]:
    return [target.add_joint(name=joint.name, type=_SLIDE, axis=joint.axis)]


def _ball(target: mujoco.MjsBody, body: Body, joint: Joint) -> list[mujoco.MjsJoint]:
    return [target.add_joint(name=joint.name, type=_BALL)]


def _planar(target: mujoco.MjsBody, body: Body, joint: Joint) -> list[mujoco.MjsJoint]:
    """Two slides in the plane, and a hinge about its normal."""
    x, y = plane_axes(joint.axis)
    return [
        target.add_joint(name=f"{joint.name}_TX", type=_SLIDE, axis=x),
        target.add_joint(name=f"{joint.name}_TY", type=_SLIDE, axis=y),
        target.add_joint(name=f"{joint.name}_RZ", type=_HINGE, axis=joint.axis),
    ]


def _floating(target: mujoco.MjsBody, body: Body, joint: Joint) -> list[mujoco.MjsJoint]:
    """A free joint, which MuJoCo has for bodies in the world only; else three slides and a ball."""
    if body.parent == WORLD:
        return [target.add_joint(name=joint.name, type=_FREE)]
    slides = [
        target.add_joint(name=f"{joint.name}_T{letter}", type=_SLIDE, axis=axis)
        for letter, axis in zip("XYZ", np.eye(3), strict=True)
    ]
    return [*slides, target.add_joint(name=f"{joint.name}_R", type=_BALL)]


Maker = Callable[[mujoco.MjsBody, Body, Joint], list[mujoco.MjsJoint]]

_MAKERS: Mapping[str, Maker] = {
    "revolute": _hinge,
    "continuous": _hinge,
    "prismatic": _slide,
    "spherical": _ball,
    "planar": _planar,
    "floating": _floating,
}


def plane_axes(normal: Array) -> tuple[Array, Array]:
    """Two axes of the plane with this normal: x and y turned the shortest way from z to it."""
    target = normal / np.linalg.norm(normal)
    quat, matrix = np.empty(4), np.empty(9)
    mujoco.mju_quatZ2Vec(quat, target)
    mujoco.mju_quat2Mat(matrix, quat)
    columns = matrix.reshape(3, 3)
    return columns[:, 0], columns[:, 1]
