"""Runs a plan in a table-top scene and records it."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.plain import Step
from orbisim.physics.mjdata import read_state
from orbisim.state import State
from orbisim.tasks.arm import ArmController
from orbisim.tasks.episode import Rollout, check_stable, clock
from orbisim.tasks.motion import Director, Plan
from orbisim.tasks.tabletop import Pose

Floats = npt.NDArray[np.float64]


class Stage:
    """A simulation in progress, as plans see it.

    Attributes:
      model, data: of the simulation.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.data = mujoco.MjData(model)

    def position(self, body: str) -> Floats:
        """Where a free body is, m."""
        address = int(self.model.joint(body).qposadr[0])
        return self.data.qpos[address : address + 3].copy()

    def yaw(self, body: str) -> float:
        """Turn of a free body about the vertical, rad."""
        address = int(self.model.joint(body).qposadr[0])
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self.data.qpos[address + 3 : address + 7])
        axes = matrix.reshape(3, 3)
        flat = int(np.argmin(np.abs(axes[2])))  # an axis of the cube that lies flat
        return float(np.arctan2(axes[1, flat], axes[0, flat]))


@dataclasses.dataclass(frozen=True)
class Script:
    """What happens in an episode.

    Attributes:
      cubes: where they stand at the start.
      tool: position of the end effector at the start, m. yaw: of the tool, rad.
      grip: at the start, from -1 (open) to 1 (closed).
      plan: makes the motion from the stage.
      joints: positions of joints after those of the arm and the cubes, rad or m.
    """

    cubes: Sequence[Pose]
    tool: tuple[float, float, float]
    plan: Callable[[Stage], Plan]
    yaw: float = 0.0
    grip: float = 1.0
    joints: tuple[float, ...] = ()


def opening_pose(script: Script, arm: ArmController) -> tuple[Floats, Floats]:
    """qpos and ctrl where the script begins: arm, fingers, cubes; the arm's target is set."""
    target = arm.solve(script.tool, script.yaw)
    opening = arm.gripper(script.grip)
    cubes = [pose.qpos for pose in script.cubes]
    qpos = np.concatenate([target, [opening / 2, opening / 2], *cubes, script.joints])
    return qpos, np.append(target, opening)


def perform(
    model: mujoco.MjModel, script: Script, arm: ArmController, steps: int, control_timestep: float
) -> tuple[Rollout, State]:
    """Runs a script for `steps` control steps; also returns the initial state."""
    model = copy.copy(model)  # effects that the scene carries change fields of it
    step = Step(model)
    stage = Stage(model)
    stage.data.qpos[:], stage.data.ctrl[:] = opening_pose(script, arm)
    plan = script.plan(stage)  # may move what it begins from
    initial = read_state(stage.data)
    director = Director(plan, arm, script.yaw, control_timestep, script.grip)
    substeps = round(control_timestep / model.opt.timestep)
    data = stage.data
    qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
    ctrl, actions = [], []
    for _ in range(steps):
        action = director.action()
        data.ctrl[:] = arm.step(action)
        step(model, data, substeps)
        actions.append(action)
        ctrl.append(data.ctrl.copy())
        qpos.append(data.qpos.copy())
        qvel.append(data.qvel.copy())
    check_stable(data)
    rollout = Rollout(
        time=clock(steps, control_timestep),
        qpos=np.array(qpos),
        qvel=np.array(qvel),
        act=np.zeros((steps + 1, 0)),
        ctrl=np.array(ctrl),
        action=np.array(actions),
    )
    return rollout, initial
