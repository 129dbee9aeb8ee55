"""Tasks of one free body."""

from __future__ import annotations

import numpy as np

from orbisim import load_scene
from orbisim.tasks.single import passive_rollout, passive_trials


def test_nobody_acts() -> None:
    time = np.arange(5) * 0.1
    rollout = passive_rollout(time, np.ones((5, 7)), np.zeros((5, 6)))
    assert (rollout.ctrl.shape, rollout.action.shape, rollout.act.shape) == ((4, 0), (4, 0), (5, 0))
    assert rollout.time is time


def test_trials_begin_where_they_are_told() -> None:
    scene = load_scene(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    qpos, qvel = np.random.default_rng(0).normal(size=(2, 3, 7))[0], np.ones((3, 6))
    setup = passive_trials(scene, qpos, qvel, horizon=0.5, control_timestep=0.1)
    np.testing.assert_array_equal(setup.initial.qpos, qpos)
    assert setup.controls(0.5, 0.1, 0).shape == (3, 5, 0)
    assert setup.horizon == 0.5
