"""A joint between two bodies as a chain of MuJoCo joints on the child.

UsdPhysics measures a joint from body0's joint frame to body1's: the chain maps frame0 to frame1
by slides along the axes of frame0, then rotations about the axes of the frame as it turns. The
child of the kinematic tree may be either body. Where it is body0 the same chain is walked
backwards with opposite axes, which leaves every coordinate with its value and sign.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence

import numpy as np

from orbisim.scene.usd.flat import FloatArray
from orbisim.scene.usd.joints import BALL, HINGE, SLIDE, Dof, Joint
from orbisim.scene.usd.pose import Pose, angle_of, quat_about, quat_product, rotate

_ROUNDING = 2e-6  # m or rad: coordinates closer to zero than single precision tells apart
_IDENTITY = np.array([1.0, 0, 0, 0])


@dataclasses.dataclass(frozen=True)
class Element:
    """One MuJoCo joint.

    Attributes:
      joint: where it comes from.
      dof: which degree of freedom it is.
      axis: [3] in the child's frame.
      anchor: [3] in the child's frame, m.
      ref: coordinate at the pose in which the scene is authored; m or rad.
      start: for a ball joint whose zero is not the authored pose, the authored coordinate.
    """

    joint: Joint
    dof: Dof
    axis: FloatArray
    anchor: FloatArray
    ref: float = 0.0
    start: FloatArray | None = None


@dataclasses.dataclass(frozen=True)
class Measured:
    """A joint's coordinates in a given pose.

    Attributes:
      coordinates: one for each degree of freedom; 0 for a ball.
      turn: the rotation of the ball, if there is one.
      offset: what the joint does not allow of the pose, m.
      twist: what the joint does not allow of the pose, rad.
    """

    coordinates: tuple[float, ...]
    turn: FloatArray
    offset: float
    twist: float


def measure(joint: Joint, between: Pose) -> Measured:
    """Coordinates of a joint when body1 has the pose `between` relative to body0."""
    frame = joint.frame0.inverse() @ between @ joint.frame1
    slides = {dof.axis for dof in joint.dofs if dof.kind == SLIDE}
    stuck = [axis for axis in range(3) if axis not in slides]
    hinges = [dof.axis for dof in joint.dofs if dof.kind == HINGE]
    has_ball = any(dof.kind == BALL for dof in joint.dofs)
    angles, twist = ({}, 0.0) if has_ball else _angles(frame.quat, hinges)
    coordinates = [
        frame.pos[dof.axis] if dof.kind == SLIDE else angles.get(dof.axis, 0.0)
        for dof in joint.dofs
    ]
    return Measured(
        tuple(0.0 if abs(value) < _ROUNDING else float(value) for value in coordinates),
        frame.quat if has_ball else _IDENTITY,
        float(np.linalg.norm(frame.pos[stuck])),
        twist,
    )


def _angles(quat: FloatArray, axes: Sequence[int]) -> tuple[dict[int, float], float]:
    """Angles about up to three axes in turn that make up a rotation, and what is left."""
    if not axes:
        return {}, angle_of(quat)
    if len(axes) == 1:
        angle = 2 * float(np.arctan2(quat[1 + axes[0]], quat[0]))
        angle = float(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
        rest = quat_product(quat_about(np.eye(3)[axes[0]], -angle), quat)
        return {axes[0]: angle}, angle_of(rest)
    from scipy.spatial.transform import Rotation

    order = [*axes, *(axis for axis in range(3) if axis not in axes)]
    rotation = Rotation.from_quat(np.roll(quat, -1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # gimbal lock: one of the equivalent triples is enough
        found = rotation.as_euler("".join("XYZ"[axis] for axis in order))
    angles = {axis: float(found[i]) for i, axis in enumerate(order)}
    return angles, 0.0 if len(axes) == 3 else abs(angles[order[2]])


def reached(joint: Joint, measured: Measured, *, with_ball: bool = True) -> Pose:
    """The pose of body1 relative to body0 at given coordinates."""
    frame = Pose()
    for dof, value in zip(joint.dofs, measured.coordinates, strict=True):
        axis = np.eye(3)[dof.axis]
        if dof.kind == SLIDE:
            step = Pose(axis * value)
        elif dof.kind == HINGE:
            step = Pose(quat=quat_about(axis, value))
        else:
            step = Pose(quat=measured.turn if with_ball else _IDENTITY)
        frame = frame @ step
    return joint.frame0 @ frame @ joint.frame1.inverse()


def elements(joint: Joint, measured: Measured, *, reverse: bool) -> list[Element]:
    """The chain's MuJoCo joints on the child, outermost first.

    Args:
      joint: the joint.
      measured: its coordinates in the pose that the child has in the model.
      reverse: whether the child is body0.
    """
    turns = _turns(joint, measured)
    if reverse:
        offset = sum(
            (np.eye(3)[dof.axis] * value
             for dof, value in zip(joint.dofs, measured.coordinates, strict=True)
             if dof.kind == SLIDE),
            np.zeros(3),
        )  # fmt: skip
        frame, anchor = joint.frame0, joint.frame0.apply(offset)
    else:
        frame, anchor = joint.frame1, joint.frame1.pos
    chain = []
    for k, dof in enumerate(joint.dofs):
        axis = np.eye(3)[dof.axis]
        if reverse:
            axis = -rotate(_product(turns[:k]), axis)
        else:
            axis = rotate(_inverse(_product(turns[k + 1 :])), axis)
        ref = 0.0 if dof.kind == BALL else measured.coordinates[k]
        start = _ball_start(frame, measured, reverse) if dof.kind == BALL else None
        chain.append(Element(joint, dof, rotate(frame.quat, axis), anchor, ref, start))
    return chain[::-1] if reverse else chain


def _turns(joint: Joint, measured: Measured) -> list[FloatArray]:
    """The rotation that each degree of freedom contributes; a ball's is left out, it is last."""
    return [
        quat_about(np.eye(3)[dof.axis], value) if dof.kind == HINGE else _IDENTITY
        for dof, value in zip(joint.dofs, measured.coordinates, strict=True)
    ]


def _ball_start(frame: Pose, measured: Measured, reverse: bool) -> FloatArray | None:
    """MuJoCo's coordinate of a ball in the authored pose, if that is not its zero."""
    if angle_of(measured.turn) < _ROUNDING:
        return None
    turn = _inverse(measured.turn) if reverse else measured.turn
    return quat_product(quat_product(frame.quat, turn), _inverse(frame.quat))


def _product(quats: Sequence[FloatArray]) -> FloatArray:
    product = _IDENTITY
    for quat in quats:
        product = quat_product(product, quat)
    return product


def _inverse(quat: FloatArray) -> FloatArray:
    return np.asarray(quat * [1, -1, -1, -1])
