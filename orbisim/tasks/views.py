"""Object-centric views of a rollout: poses and velocities of entities in the world frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording.quaternions import continuous
from orbisim.scene import matrices
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
    """The episode as it is stored: the rollout, its views and the scene's rows."""
    bodies = [int(model.body(name).id) for name in cast.objects]
    arrays: dict[str, npt.NDArray[Any]] = {
        field.name: getattr(rollout, field.name) for field in dataclasses.fields(rollout)
    }
    arrays.update(_entity_views(model, cast, bodies, rollout))
    names = (*(("robot",) if cast.robot else ()), *cast.objects)
    arrays["entities/names"] = np.array(names, dtype="S32")
    arrays.update(_static(model, cast, bodies, control_timestep))
    columns = {
        "descriptor/objects": matrices.OBJECT_COLUMNS,
        "descriptor/world": matrices.WORLD_COLUMNS,
        "descriptor/joints": matrices.JOINT_COLUMNS,
        "descriptor/actuators": matrices.ACTUATOR_COLUMNS,
    }
    return Episode(subtask, seed, scene_hash, arrays, columns, success)


def _static(
    model: mujoco.MjModel, cast: Cast, bodies: Sequence[int], control_timestep: float
) -> dict[str, Floats]:
    rows = [matrices.object_row(model, body) for body in bodies]
    place = {body: index for index, body in enumerate(bodies)}
    return {
        "descriptor/objects": np.array(rows).reshape(len(bodies), -1),
        "descriptor/parents": np.array(
            [place.get(int(model.body_weldid[model.body_parentid[body]]), -1) for body in bodies],
            np.float64,
        ),
        "descriptor/world": matrices.world_row(model, cast.surface, control_timestep),
        "descriptor/joints": matrices.joint_rows(model, bodies),
        "descriptor/actuators": matrices.actuator_rows(model),
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
    for body in range(poses.shape[1]):
        poses[:, body, 3:] = continuous(poses[:, body, 3:])
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
