"""Plans run in a table-top scene."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import make_backend
from orbisim.tasks.arm import UR5E
from orbisim.tasks.armtask import controller
from orbisim.tasks.motion import Hold, Move
from orbisim.tasks.push import Push
from orbisim.tasks.staging import Script, Stage, opening_pose, perform
from orbisim.tasks.tabletop import Pose

POSES = [Pose((0.5, 0.1, 0.03), 0.3), Pose((0.4, -0.2, 0.03), -1.2)]


def script(*segments: Move | Hold, grip: float = 1.0) -> Script:
    return Script(POSES, (0.45, 0.05, 0.2), lambda stage: iter(segments), yaw=0.2, grip=grip)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return Push().scene().model


def test_where_a_script_begins(model: mujoco.MjModel) -> None:
    stage = Stage(model)
    stage.data.qpos[:], ctrl = opening_pose(script(grip=-1.0), controller(UR5E))
    mujoco.mj_forward(model, stage.data)
    np.testing.assert_allclose(stage.data.site("tcp").xpos, [0.45, 0.05, 0.2], atol=1e-4)
    assert stage.position("cube2").tolist() == [0.4, -0.2, 0.03]
    assert stage.yaw("cube1") == pytest.approx(0.3)
    assert ctrl[-1] == UR5E.opening  # open
    np.testing.assert_array_equal(ctrl[:-1], stage.data.qpos[:6])


def test_the_turn_of_a_cube_on_its_side(model: mujoco.MjModel) -> None:
    stage = Stage(model)
    address = int(model.joint("cube1").qposadr[0])
    for axis in ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]):
        tipped, turned = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(tipped, np.array(axis), np.pi / 2)
        mujoco.mju_axisAngle2Quat(turned, np.array([0, 0, 1.0]), 0.2)
        mujoco.mju_mulQuat(stage.data.qpos[address + 3 : address + 7], turned, tipped)
        assert (stage.yaw("cube1") - 0.2) % (np.pi / 2) == pytest.approx(0, abs=1e-9) or (
            stage.yaw("cube1") - 0.2
        ) % (np.pi / 2) == pytest.approx(np.pi / 2, abs=1e-9)


def test_a_plan_is_carried_out_and_can_be_replayed(model: mujoco.MjModel) -> None:
    goal = (0.5, -0.05, 0.25)
    rollout, initial = perform(model, script(Move(goal, speed=0.5)), controller(UR5E), 20, 0.05)
    assert rollout.ctrl.shape == (20, 7)
    assert rollout.qpos.shape == (21, model.nq)
    data = mujoco.MjData(model)
    data.qpos[:] = rollout.qpos[-1]
    mujoco.mj_kinematics(model, data)
    assert np.linalg.norm(data.site("tcp").xpos - goal) < 0.02
    backend = make_backend("mujoco", Push().scene())
    nstep = round(0.05 / model.opt.timestep)
    again = backend.rollout(initial, rollout.ctrl[None], nstep=nstep)
    np.testing.assert_allclose(again.qpos[0], rollout.qpos[1:], atol=1e-8)


def test_a_plan_may_look_at_what_happened(model: mujoco.MjModel) -> None:
    seen = []

    def plan(stage: Stage):
        for _ in range(3):
            seen.append(float(stage.data.time))
            yield Hold(2)

    perform(model, Script(POSES, (0.45, 0.05, 0.2), plan), controller(UR5E), 6, 0.05)
    np.testing.assert_allclose(seen, [0.0, 0.1, 0.2])
