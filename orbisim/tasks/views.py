"""Object-centric views of a rollout: poses and velocities of entities in the world frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.tasks import descriptors
from orbisim.tasks.episode import Episode, Rollout

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Cast:
    """Who plays in a scene.

    Attributes:
      objects: bodies that are entities of their own, in order.
      robot: site of the end effector; None without a robot.
      surface: geom of the supporting surface; None for the first plane.
      gripper: joints whose sum is the opening of the gripper.
    """

    objects: tuple[str, ...]
    robot: str | None = None
    surface: str | None = None
    gripper: tuple[str, ...] = ()


def free_bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the bodies with a free joint."""
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    return tuple(model.body(int(body)).name for body in model.jnt_bodyid[free])


def moving_bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the bodies that some joint moves."""
    return tuple(
        model.body(body).name
        for body in range(1, model.nbody)
        if model.body_weldid[body] != 0 and model.body_weldid[body] == body
    )


def make_episode(
    model: mujoco.MjModel,
    cast: Cast,
    rollout: Rollout,
    *,
    subtask: str,
    seed: int,
    scene_hash: str,
    control_timestep: float,
    success: bool | None = None,
) -> Episode:
    """The episode as it is stored: the rollout, its views and the scene's descriptors."""
    bodies = [int(model.body(name).id) for name in cast.objects]
    arrays: dict[str, npt.NDArray[Any]] = {
        field.name: getattr(rollout, field.name) for field in dataclasses.fields(rollout)
    }
    arrays.update(_entity_views(model, cast, bodies, rollout))
    names = (*(("robot",) if cast.robot else ()), *cast.objects)
    arrays["entities/names"] = np.array(names, dtype="S32")
    arrays.update(_static(model, cast, bodies, control_timestep))
    columns = {
        "descriptor/objects": descriptors.OBJECT_COLUMNS,
        "descriptor/world": descriptors.WORLD_COLUMNS,
        "descriptor/joints": descriptors.JOINT_COLUMNS,
        "descriptor/actuators": descriptors.ACTUATOR_COLUMNS,
    }
    return Episode(subtask, seed, scene_hash, arrays, columns, success)


def _static(
    model: mujoco.MjModel, cast: Cast, bodies: Sequence[int], control_timestep: float
) -> dict[str, Floats]:
    rows = [descriptors.object_row(model, body) for body in bodies]
    place = {body: index for index, body in enumerate(bodies)}
    return {
        "descriptor/objects": np.array(rows).reshape(len(bodies), -1),
        "descriptor/parents": np.array(
            [place.get(int(model.body_weldid[model.body_parentid[body]]), -1) for body in bodies],
            np.float64,
        ),
        "descriptor/world": descriptors.world_row(model, cast.surface, control_timestep),
        "descriptor/joints": descriptors.joint_rows(model, bodies),
        "descriptor/actuators": descriptors.actuator_rows(model),
    }


def _entity_views(
    model: mujoco.MjModel, cast: Cast, bodies: Sequence[int], rollout: Rollout
) -> dict[str, npt.NDArray[np.float32]]:
    count, n = len(rollout.time), len(bodies)
    poses = np.zeros((count, n + 1, 7))
    velocities = np.zeros((count, n + 1, 6))
    data = mujoco.MjData(model)
    site = int(model.site(cast.robot).id) if cast.robot else -1
    for t in range(count):
        data.qpos[:], data.qvel[:] = rollout.qpos[t], rollout.qvel[t]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        for i, body in enumerate(bodies):
            poses[t, i, :3], poses[t, i, 3:] = data.xpos[body], data.xquat[body]
            _velocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocities[t, i])
        if site >= 0:
            poses[t, n, :3] = data.site_xpos[site]
            mujoco.mju_mat2Quat(poses[t, n, 3:], data.site_xmat[site])
            _velocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocities[t, n])
    poses[:, :, 3:] = continuous(poses[:, :, 3:])
    views = _named("objects", poses[:, :n], velocities[:, :n])
    if site >= 0:
        views.update(_named("robot", poses[:, n], velocities[:, n]))
        views.update(_robot_joints(model, cast, rollout))
    return {name: values.astype(np.float32) for name, values in views.items()}


def _velocity(
    model: mujoco.MjModel, data: mujoco.MjData, kind: mujoco.mjtObj, index: int, out: Floats
) -> None:
    mujoco.mj_objectVelocity(model, data, kind, index, out, 0)


def _named(prefix: str, poses: Floats, velocities: Floats) -> dict[str, Floats]:
    return {
        f"{prefix}/pos": poses[..., :3],
        f"{prefix}/quat": poses[..., 3:],
        f"{prefix}/linvel": velocities[..., 3:],
        f"{prefix}/angvel": velocities[..., :3],
    }


def _robot_joints(model: mujoco.MjModel, cast: Cast, rollout: Rollout) -> dict[str, Floats]:
    """Coordinates of all joints but the free ones, and the opening of the gripper in m."""
    scalar = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    opening = sum(rollout.qpos[:, model.joint(name).qposadr[0]] for name in cast.gripper)
    return {
        "robot/qpos": rollout.qpos[:, model.jnt_qposadr[scalar]],
        "robot/qvel": rollout.qvel[:, model.jnt_dofadr[scalar]],
        "robot/gripper": np.asarray(opening).reshape(-1, 1),
    }


def continuous(quats: Floats) -> Floats:
    """Quaternions [T, N, 4] with signs such that consecutive ones are close."""
    dots = np.sum(quats[1:] * quats[:-1], axis=-1)
    flips = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    result = quats.copy()
    result[1:] *= flips[..., None]
    return result
