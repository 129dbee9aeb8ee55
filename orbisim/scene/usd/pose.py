"""Rigid poses, and how to get one out of a matrix that also scales."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.scene.usd.flat import FloatArray

_SHEAR = 1e-6
"""Cosine of the angle between two axes above which a matrix is taken to shear."""


@dataclasses.dataclass(frozen=True)
class Pose:
    """A rigid transform: first rotate, then translate.

    Attributes:
      pos: [3] in m.
      quat: [4] unit quaternion (w, x, y, z).
    """

    pos: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    quat: FloatArray = dataclasses.field(default_factory=lambda: np.array([1.0, 0, 0, 0]))

    @classmethod
    def of(cls, pos: npt.ArrayLike, rotation: FloatArray) -> Pose:
        """From a position and a rotation matrix [3, 3]."""
        return cls(np.asarray(pos, np.float64), quat_of(rotation))

    @property
    def rotation(self) -> FloatArray:
        """[3, 3]."""
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, self.quat)
        return matrix.reshape(3, 3)

    def __matmul__(self, inner: Pose) -> Pose:
        """The composition: `(a @ b)` maps a point through `b`, then `a`."""
        return Pose(self.apply(inner.pos), quat_product(self.quat, inner.quat))

    def inverse(self) -> Pose:
        """The transform that undoes this one."""
        back = self.quat * [1, -1, -1, -1]
        return Pose(-rotate(back, self.pos), back)

    def apply(self, point: npt.ArrayLike) -> FloatArray:
        """A point [3], transformed."""
        return self.pos + rotate(self.quat, point)

    def distance(self, other: Pose) -> tuple[float, float]:
        """How far another pose is away: m, rad."""
        between = self.inverse() @ other
        return float(np.linalg.norm(between.pos)), angle_of(between.quat)


@dataclasses.dataclass(frozen=True)
class Placement:
    """A prim's transform to the world, split into a rigid pose and a stretch.

    Attributes:
      pose: where the prim's frame is; m, z up.
      stretch: [3, 3] what it does to vectors before the pose: diagonal unless `shears`.
      shears: whether `stretch` is more than a scale along the prim's own axes.
    """

    pose: Pose
    stretch: FloatArray
    shears: bool

    @property
    def scale(self) -> FloatArray:
        """[3] signed factors along the prim's axes (of its diagonal, if it shears)."""
        return np.diag(self.stretch).copy()

    def point(self, local: npt.ArrayLike) -> FloatArray:
        """A point in the prim's frame, as it lies in the frame of `pose`; m."""
        return np.asarray(self.stretch @ np.asarray(local, np.float64))


def split(matrix: FloatArray) -> Placement:
    """Splits an affine matrix [4, 4] into rotation and stretch.

    A mirroring matrix stretches by negative factors along all three axes: the convention of
    `GfMatrix4d::Factor`, on which UsdPhysics builds.
    """
    linear = matrix[:3, :3]
    lengths = np.linalg.norm(linear, axis=0)
    sign = -1.0 if np.linalg.det(linear) < 0 else 1.0
    if lengths.all():
        axes = linear / lengths * sign
        if np.abs(axes.T @ axes - np.eye(3)).max() < _SHEAR:
            pose = Pose.of(matrix[:3, 3], _orthonormal(axes))
            return Placement(pose, np.diag(lengths * sign), False)
    rotation = _polar(linear)
    stretch = rotation.T @ linear
    aside = np.abs(stretch - np.diag(np.diag(stretch))).max()
    return Placement(
        Pose.of(matrix[:3, 3], rotation), stretch, bool(aside > _SHEAR * lengths.max())
    )


def quat_of(rotation: FloatArray) -> FloatArray:
    """Unit quaternion (w, x, y, z) of a rotation matrix [3, 3]."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation, np.float64).ravel())
    return normalized(quat)


def quat_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Quaternion product."""
    product = np.zeros(4)
    mujoco.mju_mulQuat(product, a, b)
    return product


def quat_about(axis: npt.ArrayLike, angle: float) -> FloatArray:
    """Rotation by `angle` (rad) about a unit axis."""
    quat = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quat, np.asarray(axis, np.float64), angle)
    return quat


def rotate(quat: FloatArray, vector: npt.ArrayLike) -> FloatArray:
    """A vector [3], rotated."""
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.asarray(vector, np.float64), quat)
    return turned


def angle_of(quat: FloatArray) -> float:
    """How far a unit quaternion turns, 0 to pi rad."""
    return 2 * float(np.arctan2(np.linalg.norm(quat[1:]), abs(quat[0])))


def normalized(quat: npt.ArrayLike) -> FloatArray:
    """A quaternion of unit length; the identity for a zero one."""
    quat = np.asarray(quat, np.float64)
    norm = np.linalg.norm(quat)
    return np.asarray(quat / norm) if norm > 0 else np.array([1.0, 0, 0, 0])


def aligning_z(direction: npt.ArrayLike) -> FloatArray:
    """A rotation that takes the z axis to a direction."""
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, np.asarray(direction, np.float64))
    return quat


def _polar(linear: FloatArray) -> FloatArray:
    """The rotation closest to a matrix."""
    left, _, right = np.linalg.svd(linear)
    if np.linalg.det(left @ right) < 0:
        left[:, 2] *= -1
    return np.asarray(left @ right)


def _orthonormal(axes: FloatArray) -> FloatArray:
    """Removes what rounding left of non-orthogonality."""
    return axes if np.abs(axes.T @ axes - np.eye(3)).max() < 1e-15 else _polar(axes)
