"""Views of a rollout, against forward kinematics and finite differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.tasks.episode import Rollout, clock
from orbisim.tasks.views import Cast, free_bodies, make_episode, moving_bodies

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco><option gravity="0 0 0"/><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
  <body name="arm" pos="0 0 1"><joint name="hinge" axis="0 0 1"/><geom size=".1"/>
    <body name="welded"><geom size=".1"/>
      <body name="hand" pos="1 0 0"><joint name="grip" type="slide"/><geom size=".1"/>
        <site name="tcp" pos=".5 0 0"/></body></body></body>
  <body name="box" pos="5 0 5"><freejoint name="box"/><geom size=".1" pos=".3 0 0"/></body>
</worldbody></mujoco>""")
STEP, STEPS = 1e-3, 50


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    data = mujoco.MjData(MODEL)
    data.qvel[:] = [1.0, 0.1, 0.2, -0.3, 0.4, 3.0, 2.0, -8.0]
    qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
    MODEL.opt.timestep = STEP
    for _ in range(STEPS):
        mujoco.mj_step(MODEL, data)
        qpos.append(data.qpos.copy())
        qvel.append(data.qvel.copy())
    empty = np.zeros((STEPS, 0))
    rollout = Rollout(clock(STEPS, STEP), np.array(qpos), np.array(qvel),
                      np.zeros((STEPS + 1, 0)), empty, empty)  # fmt: skip
    cast = Cast(("hand", "box"), robot="tcp", gripper=("grip", "grip"))
    episode = make_episode(
        MODEL, cast, rollout, subtask="s", seed=1, scene_hash="h", control_timestep=STEP
    )
    return dict(episode.arrays)


def test_who_moves() -> None:
    assert free_bodies(MODEL) == ("box",)
    assert moving_bodies(MODEL) == ("arm", "hand", "box")


def test_positions_are_those_of_kinematics(arrays: dict[str, np.ndarray]) -> None:
    angle, slide = arrays["qpos"][-1, :2]
    along = np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(arrays["objects/pos"][-1, 0], [*along, 1 + slide], atol=1e-6)
    np.testing.assert_allclose(arrays["robot/pos"][-1], [*(1.5 * along), 1 + slide], atol=1e-6)
    np.testing.assert_allclose(arrays["objects/pos"][:, 1], arrays["qpos"][:, 2:5], atol=1e-6)


@pytest.mark.parametrize("who", ["objects", "robot"])
def test_velocities_are_the_slopes_of_positions(arrays: dict[str, np.ndarray], who: str) -> None:
    slopes = np.gradient(arrays[f"{who}/pos"].astype(float), STEP, axis=0)
    # float32 positions limit what a difference says
    np.testing.assert_allclose(slopes[2:-2], arrays[f"{who}/linvel"][2:-2], atol=0.015)


def test_turns_are_those_of_quaternions(arrays: dict[str, np.ndarray]) -> None:
    quats = arrays["objects/quat"][:, 1].astype(float)
    assert (np.sum(quats[1:] * quats[:-1], axis=1) > 0.9).all()
    back, turn, rate = np.empty(4), np.empty(4), np.empty(3)
    for t in (0, STEPS - 1):
        mujoco.mju_negQuat(back, quats[t])
        mujoco.mju_mulQuat(turn, quats[t + 1], back)
        mujoco.mju_quat2Vel(rate, turn, STEP)
        np.testing.assert_allclose(rate, arrays["objects/angvel"][t, 1], atol=0.05)


def test_the_robots_own_joints(arrays: dict[str, np.ndarray]) -> None:
    np.testing.assert_array_equal(arrays["robot/qpos"], arrays["qpos"][:, :2].astype(np.float32))
    np.testing.assert_allclose(arrays["robot/gripper"][:, 0], 2 * arrays["qpos"][:, 1], rtol=1e-6)


def test_who_hangs_on_whom(arrays: dict[str, np.ndarray]) -> None:
    assert arrays["entities/names"].tolist() == [b"robot", b"hand", b"box"]
    assert arrays["descriptor/parents"].tolist() == [-1, -1]
    assert arrays["descriptor/objects"].shape[0] == 2
    cast = Cast(("arm", "hand"))
    rollout = Rollout(*(arrays[n] for n in ("time", "qpos", "qvel", "act", "ctrl", "action")))
    chain = make_episode(
        MODEL, cast, rollout, subtask="s", seed=1, scene_hash="h", control_timestep=STEP
    )
    assert chain.arrays["descriptor/parents"].tolist() == [-1, 0]  # past what is welded
    assert "robot/pos" not in chain.arrays
