"""Errors between two state sequences, by signal group.

The groups, each a root mean square over the elements it covers:

| group | covers | unit |
| --- | --- | --- |
| `joint_position` | hinge angles, slide positions, rotation angles between ball joints | rad or m |
| `joint_velocity` | hinge, slide and ball joint velocities | rad/s or m/s |
| `object_position` | distances between the origins of free bodies | m |
| `object_rotation` | geodesic distances on SO(3) between free bodies | rad |
| `object_velocity` | distances between the linear velocities of free bodies | m/s |

A floating-base robot counts as a free body together with its joints.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

GROUPS = (
    "joint_position",
    "joint_velocity",
    "object_position",
    "object_rotation",
    "object_velocity",
)


@dataclasses.dataclass(frozen=True)
class Layout:
    """Where the elements of each signal group stand in qpos and qvel.

    Attributes:
      scalar_q, scalar_v: addresses of hinge and slide joints in qpos and qvel.
      ball_q, ball_v: first addresses of ball joints.
      free_q, free_v: first addresses of free joints.
      units: unit of each group that the scene has.
    """

    scalar_q: npt.NDArray[np.int64]
    scalar_v: npt.NDArray[np.int64]
    ball_q: npt.NDArray[np.int64]
    ball_v: npt.NDArray[np.int64]
    free_q: npt.NDArray[np.int64]
    free_v: npt.NDArray[np.int64]
    units: Mapping[str, str]

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups that the scene has."""
        return tuple(self.units)


def layout(model: mujoco.MjModel) -> Layout:
    """Finds the signal groups of a model."""
    kinds = np.asarray(model.jnt_type)
    hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    ball, free = mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_FREE
    scalar = np.isin(kinds, (int(hinge), int(slide)))
    units: dict[str, str] = {}
    if scalar.any() or (kinds == ball).any():
        unit = _joint_unit(
            bool((kinds == slide).any()), bool(np.isin(kinds, (int(hinge), int(ball))).any())
        )
        units["joint_position"] = unit
        units["joint_velocity"] = " or ".join(f"{part}/s" for part in unit.split(" or "))
    if (kinds == free).any():
        units |= {"object_position": "m", "object_rotation": "rad", "object_velocity": "m/s"}
    q, v = np.asarray(model.jnt_qposadr, np.int64), np.asarray(model.jnt_dofadr, np.int64)
    return Layout(
        q[scalar], v[scalar], q[kinds == ball], v[kinds == ball], q[kinds == free],
        v[kinds == free], units,
    )  # fmt: skip


def _joint_unit(slides: bool, turns: bool) -> str:
    return "rad or m" if slides and turns else "m" if slides else "rad"


def errors(
    where: Layout, qpos_a: Floats, qvel_a: Floats, qpos_b: Floats, qvel_b: Floats
) -> dict[str, Floats]:
    """Error of each signal group.

    Args:
      where: the scene's layout.
      qpos_a, qpos_b: [..., nq]. qvel_a, qvel_b: [..., nv].

    Returns:
      For each group of the scene an array [...]: the root mean square over its elements.
    """
    dq, dv = qpos_b - qpos_a, qvel_b - qvel_a
    found: dict[str, Floats] = {}
    if "joint_position" in where.units:
        turns = [_rotation(qpos_a, qpos_b, adr) for adr in where.ball_q]
        found["joint_position"] = _rms([dq[..., where.scalar_q], *(t[..., None] for t in turns)])
        spins = [dv[..., adr : adr + 3] for adr in where.ball_v]
        found["joint_velocity"] = _rms([dv[..., where.scalar_v], *spins])
    if "object_position" in where.units:
        found["object_position"] = _rms_of_norms([dq[..., a : a + 3] for a in where.free_q])
        found["object_rotation"] = _rms(
            [_rotation(qpos_a, qpos_b, adr + 3)[..., None] for adr in where.free_q]
        )
        found["object_velocity"] = _rms_of_norms([dv[..., a : a + 3] for a in where.free_v])
    return found


def rotation_angle(quat_a: Floats, quat_b: Floats) -> Floats:
    """Geodesic distance on SO(3) between unit quaternions [..., 4], rad, in [0, pi].

    2 atan2(|vec|, |scalar|) of the relative rotation: accurate also for small angles.
    """
    wa, va = quat_a[..., :1], quat_a[..., 1:]
    wb, vb = quat_b[..., :1], quat_b[..., 1:]
    scalar = (wa * wb).sum(-1) + (va * vb).sum(-1)
    vector = wa * vb - wb * va - np.cross(va, vb)
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(vector, axis=-1), np.abs(scalar)))


def _rotation(qpos_a: Floats, qpos_b: Floats, adr: int) -> Floats:
    return rotation_angle(qpos_a[..., adr : adr + 4], qpos_b[..., adr : adr + 4])


def _rms(parts: list[Floats]) -> Floats:
    every = np.concatenate(parts, axis=-1)
    return np.asarray(np.sqrt(np.mean(every**2, axis=-1)))


def _rms_of_norms(parts: list[Floats]) -> Floats:
    squares = [np.sum(part**2, axis=-1) for part in parts]
    return np.asarray(np.sqrt(functools.reduce(np.add, squares) / len(squares)))


def poses(
    model: mujoco.MjModel, qpos: Floats, frames: Sequence[tuple[str, str]]
) -> tuple[Floats, Floats]:
    """Where frames are.

    Args:
      model: of the scene. qpos: [nworld, T, nq].
      frames: of each of K frames its kind, `body` or `site`, and its name.

    Returns:
      Positions [nworld, T, K, 3], m, and unit quaternions [nworld, T, K, 4] (w, x, y, z) in the
      world frame; NaN where a state is not finite.
    """
    data = mujoco.MjData(model)
    place = np.full((*qpos.shape[:2], len(frames), 3), np.nan)
    turn = np.full((*qpos.shape[:2], len(frames), 4), np.nan)
    views = [getattr(data, kind)(name) for kind, name in frames]
    for index in np.ndindex(*qpos.shape[:2]):
        if not np.isfinite(qpos[index]).all():
            continue
        data.qpos[:] = qpos[index]
        mujoco.mj_kinematics(model, data)
        for number, view in enumerate(views):
            place[(*index, number)] = view.xpos
            mujoco.mju_mat2Quat(turn[(*index, number)], view.xmat)
    return place, turn


@dataclasses.dataclass(frozen=True)
class Energies:
    """Mechanical energy and contacts along state sequences.

    Attributes:
      potential, kinetic: [nworld, T], J.
      contacts: [nworld, T] number of active contacts.
    """

    potential: Floats
    kinetic: Floats
    contacts: npt.NDArray[np.int64]

    @property
    def total(self) -> Floats:
        """Potential plus kinetic energy, J."""
        return self.potential + self.kinetic


def energies(model: mujoco.MjModel, qpos: Floats, qvel: Floats) -> Energies:
    """Computes energy and contacts of states [nworld, T, ...] by C MuJoCo's formulas.

    States that are not finite give NaN and -1 contacts.
    """
    data = mujoco.MjData(model)
    shape = qpos.shape[:2]
    potential, kinetic = np.full(shape, np.nan), np.full(shape, np.nan)
    contacts = np.full(shape, -1)
    for index in np.ndindex(*shape):
        if not (np.isfinite(qpos[index]).all() and np.isfinite(qvel[index]).all()):
            continue
        data.qpos[:], data.qvel[:] = qpos[index], qvel[index]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        potential[index], kinetic[index] = data.energy
        contacts[index] = data.ncon
    return Energies(potential, kinetic, contacts)


def quantiles(values: Floats, levels: tuple[float, ...] = (0.5, 0.95)) -> list[list[float]]:
    """Quantiles over the first axis, ignoring NaN; NaN where nothing is left."""
    if not len(values):
        return [[] for _ in levels]
    finite = np.where(np.isfinite(values), values, np.nan)
    some = np.isfinite(finite).any(axis=0)
    result = np.full((len(levels), values.shape[1]), np.nan)
    if some.any():
        result[:, some] = np.nanquantile(finite[:, some], levels, axis=0)
    return [[float(x) for x in row] for row in result]
