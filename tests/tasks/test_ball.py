"""The ball: Newton's example, in NumPy and in MJCF."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim import tasks
from orbisim.tasks.ball_reference import BallConfig, simulate


def test_episodes_come_from_the_reference() -> None:
    episode = tasks.make("ball").episode("throw", 5)
    start = episode.arrays["qvel"][0, :3]
    positions, _ = simulate(start)
    np.testing.assert_array_equal(episode.arrays["qpos"][:, :3], positions)
    assert episode.steps == 36
    assert episode.arrays["objects/pos"].shape == (37, 1, 3)


def test_the_mjcf_scene_bounces_alike() -> None:
    model = tasks.make("ball").scene().model
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 288)
    positions, _ = simulate(BallConfig().velocity)
    assert np.linalg.norm(data.qpos[:3] - positions[-1]) < 0.02
