"""Free bodies, joints and surfaces of a scene, as far as looking for them in an image needs."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation

from orbisim.scene.visible import ROBOT
from orbisim_diffusion.solids import View
from orbisim_diffusion.symmetry import cube_rotations
from orbisim_diffusion.synthesis import Eye

Floats = npt.NDArray[np.float64]

_JOINT, _SLIDE = 0.15, 0.01
"""Prior of a joint about a first guess, rad and m, for what a frame does not show."""
_READ_JOINT, _READ_SLIDE = 0.02, 0.002
"""The same about what a network reads off the frame: as far as StaInf is off."""
_GONE_JOINT, _GONE_SLIDE = 0.03, 0.003
"""What a joint moves otherwise than at its speed from one frame to the next."""
MARGIN = 5
"""Pixels around an object's outline that count in its fit."""
_TURNS = 4
"""Turns about the vertical from which an upright box is fitted, over its period."""


@dataclasses.dataclass(frozen=True)
class Body:
    """A free body.

    Attributes:
      qpos, dof: where its coordinates and velocities begin. geoms: places among those that are
        drawn. centre, half: [3] of its bounding box in its own frame, m. colour: [3].
      faces: [K, 3, 3] orientations in which it rests on a face, one of each kind that look alike.
      period: of turns about the vertical that look alike, rad. box: whether it is a single box.
    """

    qpos: int
    dof: int
    geoms: torch.Tensor
    centre: Floats
    half: Floats
    colour: Floats
    faces: Floats
    period: float
    box: bool


class Scalar(NamedTuple):
    """Joints with one coordinate.

    Attributes:
      qpos, dof: [J] their coordinates and velocities. prior, read, gone: [J] standard
        deviations about a first guess, about what a network reads, and about where the last two
        frames have it go, rad or m.
      low, high: [J] their ranges; infinite where they have none. hinge: [J] which are hinges.
    """

    qpos: npt.NDArray[np.int64]
    dof: npt.NDArray[np.int64]
    prior: Floats
    read: Floats
    gone: Floats
    low: Floats
    high: Floats
    hinge: npt.NDArray[np.bool_]


class Surface(NamedTuple):
    """The upper side of something that stands still: corners x, y, and its height, m."""

    low: Floats
    high: Floats
    top: float

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is above it."""
        return bool(self.low[0] <= x <= self.high[0] and self.low[1] <= y <= self.high[1])


def at_rest(
    body: Body, spot: Floats, surfaces: Sequence[Surface], eye: Floats, close: bool
) -> Floats:
    """Poses [S, 7] in which the body rests on the surface below a place.

    Args:
      body: the body. spot: [7] its pose, about. surfaces: that it may rest on.
      eye: [3] the camera, m. close: whether the orientation of `spot` is nearly right; else poses
        with all orientations that look different.
    """
    turn = Rotation.from_quat(np.roll(spot[3:], -1)).as_matrix()
    poses = []
    for face in body.faces:
        yaw = _nearest_yaw(turn @ face.T, body.period)
        steps = 1 if close else _TURNS
        for i in range(steps):
            about = Rotation.from_euler("z", yaw + i * body.period / steps).as_matrix()
            poses.append(_resting(body, spot, about @ face, surfaces, eye))
    return np.stack(poses)


def overlap(eye: Eye, qpos: Floats, one: Body, other: Body) -> float:
    """By how much a body is within another one, m; 0 if they are apart or never collide."""
    model, data = eye.model, mujoco.MjData(eye.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    deepest = 0.0
    for a, b in itertools.product(one.geoms.tolist(), other.geoms.tolist()):
        g, h = int(eye.rows[a, 8]), int(eye.rows[b, 8])
        collide = model.geom_contype[g] & model.geom_conaffinity[h]
        if collide or model.geom_contype[h] & model.geom_conaffinity[g]:
            deepest = min(deepest, mujoco.mj_geomDistance(model, data, g, h, 0.0, None))
    return -deepest


def directions(nv: int, body: Body, pose: Floats, upright: bool) -> Floats:
    """[nv, 3 or 6]: along x, y and about the vertical; or all six."""
    columns = [0, 1] if upright else [0, 1, 2]
    found = np.zeros((nv, 3 if upright else 6))
    for i, axis in enumerate(columns):
        found[body.dof + axis, i] = 1.0
    turn = Rotation.from_quat(np.roll(pose[3:], -1)).as_matrix()
    local = slice(body.dof + 3, body.dof + 6)  # a free joint turns about the body's own axes
    if upright:
        found[local, 2] = turn.T @ np.array([0.0, 0.0, 1.0])
    else:
        found[local, 3:] = turn.T
    return found


def window(view: View, height: int, body: Body, place: Floats, wide: float) -> torch.Tensor:
    """Pixels [P] around an object, `wide` times as wide as it is; numbers, row by row.

    Args:
      view: one camera. height: and width of its image, pixels. place: [3] of the object, m.
    """
    pos, rot, focal, offset = (field[0].double().numpy() for field in view)
    local = rot.T @ (place - pos)
    depth = -local[2]
    if depth < 0.05:
        return torch.zeros(0, dtype=torch.long)
    focal, offset = focal * height, offset * height
    x = focal[0] * local[0] / depth + offset[0] + height / 2
    y = -focal[1] * local[1] / depth + offset[1] + height / 2
    radius = 0.6 * wide * np.linalg.norm(body.half) * focal[1] / depth + MARGIN
    rows = np.arange(max(0, int(y - radius)), min(height, int(y + radius) + 1))
    columns = np.arange(max(0, int(x - radius)), min(height, int(x + radius) + 1))
    return torch.as_tensor((rows[:, None] * height + columns).reshape(-1))


def scalar_joints(model: mujoco.MjModel) -> Scalar:
    """The joints of a model with one coordinate."""
    kinds = model.jnt_type
    slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
    which = [
        j for j in range(model.njnt) if int(kinds[j]) in (slide, int(mujoco.mjtJoint.mjJNT_HINGE))
    ]
    slides = np.array([int(kinds[j]) == slide for j in which], bool)
    prior = np.where(slides, _SLIDE, _JOINT)
    read = np.where(slides, _READ_SLIDE, _READ_JOINT)
    gone = np.where(slides, _GONE_SLIDE, _GONE_JOINT)
    limited = model.jnt_limited[which].astype(bool)
    low, high = (
        np.where(limited, model.jnt_range[which, end], sign * np.inf)
        for end, sign in ((0, -1.0), (1, 1.0))
    )
    qpos, dof = (field[which].astype(int) for field in (model.jnt_qposadr, model.jnt_dofadr))
    return Scalar(qpos, dof, prior, read, gone, low, high, ~slides)


def free_bodies(eye: Eye) -> list[Body]:
    """The free bodies of a scene, in the order of their joints."""
    model = eye.model
    free = [j for j in range(model.njnt) if int(model.jnt_type[j]) == mujoco.mjtJoint.mjJNT_FREE]
    found = []
    for number, joint in enumerate(free, 1):
        geoms = torch.nonzero(eye.entity == number)[:, 0]
        low, high = _bounds(eye, geoms, int(model.jnt_bodyid[joint]))
        half = 0.5 * (high - low)
        colour = eye.rows[geoms[0], 4:7] if len(geoms) else np.ones(3)
        box = len(geoms) == 1 and int(eye.rows[geoms[0], 0]) == mujoco.mjtGeom.mjGEOM_BOX
        faces = _faces(half) if box else np.eye(3)[None]
        square = box and abs(half[0] - half[1]) < 0.02 * half.max()
        found.append(
            Body(
                int(model.jnt_qposadr[joint]),
                int(model.jnt_dofadr[joint]),
                geoms,
                0.5 * (low + high),
                half,
                np.asarray(colour),
                faces,
                np.pi / 2 if square and len(faces) == 1 else np.pi if box else 2 * np.pi,
                box,
            )
        )
    return found


def _bounds(eye: Eye, geoms: torch.Tensor, body: int) -> tuple[Floats, Floats]:
    """The box around a body's geoms in the body's frame."""
    model, low, high = eye.model, np.full(3, np.inf), np.full(3, -np.inf)
    numbers = eye.rows[geoms.numpy(), 8].astype(int)
    for geom in numbers:
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        rot = turn.reshape(3, 3)
        centre = model.geom_pos[geom] + rot @ model.geom_aabb[geom, :3]
        reach = np.abs(rot) @ model.geom_aabb[geom, 3:]
        low, high = np.minimum(low, centre - reach), np.maximum(high, centre + reach)
    return (low, high) if len(numbers) else (np.zeros(3), np.zeros(3))


def _faces(half: Floats) -> Floats:
    """[K, 3, 3]: one orientation for each face to rest on that looks different."""
    unit = 0.02 * half.max()  # heights that differ by less are one
    kinds = {
        round(float((np.abs(turn) @ half)[2]) / unit): turn
        for turn in cube_rotations().double().numpy()
    }
    return np.stack(list((kinds | {round(half[2] / unit): np.eye(3)}).values()))


def surfaces(eye: Eye) -> list[Surface]:
    """Upper sides of boxes and planes that stand still and lie flat."""
    model, data, found = eye.model, mujoco.MjData(eye.model), []
    mujoco.mj_kinematics(model, data)
    for place in torch.nonzero(eye.entity < ROBOT)[:, 0].tolist():
        geom = int(eye.rows[place, 8])
        kind, turn = int(model.geom_type[geom]), data.geom_xmat[geom].reshape(3, 3)
        if abs(abs(turn[2, 2]) - 1.0) > 1e-3:
            continue
        pos, size = data.geom_xpos[geom], model.geom_size[geom]
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            reach = np.abs(turn) @ size
            found.append(Surface(pos[:2] - reach[:2], pos[:2] + reach[:2], float(pos[2] + size[2])))
        elif kind == mujoco.mjtGeom.mjGEOM_PLANE:
            reach = np.where(size[:2] > 0, size[:2], 1e3)
            found.append(Surface(pos[:2] - reach, pos[:2] + reach, float(pos[2])))
    return found


def _resting(
    body: Body, spot: Floats, turn: Floats, surfaces: Sequence[Surface], eye: Floats
) -> Floats:
    """The pose [7] with this orientation on the highest surface under a place."""
    reach = np.abs(turn) @ body.half
    centre = turn @ body.centre
    x, y = spot[:2]
    tops = [s.top for s in surfaces if s.holds(x, y) and s.top < spot[2] + reach[2]]
    lowest = max(tops, default=spot[2] - reach[2])
    way = spot[:3] - eye
    z = lowest + reach[2] - centre[2]
    # along the line of sight, so that the place in the image stays
    share = (z - eye[2]) / way[2] if abs(way[2]) > 1e-3 else 1.0
    place = eye + share * way if 0.5 < share < 2.0 else np.array([x, y, z])
    quat = np.roll(Rotation.from_matrix(turn).as_quat(), 1)
    return np.array([*place[:2], z, *quat])


def _nearest_yaw(turn: Floats, period: float) -> float:
    """The turn about the vertical that is nearest to a rotation, within one period."""
    yaw = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    return float(yaw % period)
