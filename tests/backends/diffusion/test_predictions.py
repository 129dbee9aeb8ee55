"""Predicted poses of the geoms of an episode begin with the true ones and stay near them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from orbisim_diffusion.predictions import (
    RECORDED,
    StateNoise,
    perturbed,
    predicted_episode,
)
from scipy.spatial.transform import Rotation

from orbisim.scene import visible
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make

SCENE = """
<mujoco><worldbody>
  <body><joint name="hinge" type="hinge" range="-10 10"/><geom size="0.1"/></body>
  <body><joint name="slide" type="slide"/><geom size="0.1"/></body>
  <body name="free" pos="0 0 1"><freejoint/><geom size="0.1"/></body>
</worldbody></mujoco>
"""


def test_noise_has_the_deviations_that_were_asked_for_and_keeps_ranges() -> None:
    model = mujoco.MjModel.from_xml_string(SCENE)
    qpos = np.tile(model.qpos0, (2000, 1))
    found = perturbed(model, qpos, StateNoise(0.01, 0.05), np.random.default_rng(0))
    assert found[:, 1].std() == pytest.approx(0.01, rel=0.1)
    assert (found[:, 2:5] - model.qpos0[2:5]).std(0) == pytest.approx(0.01, rel=0.1)
    turns = Rotation.from_quat(np.roll(found[:, 5:], -1, axis=1)).as_rotvec()
    assert turns.std(0) == pytest.approx(0.05, rel=0.1)
    assert np.abs(found[:, 0]).max() <= np.radians(10.0)
    wide = perturbed(model, qpos, StateNoise(0.01, 1.0), np.random.default_rng(0))
    assert np.abs(wide[:, 0]).max() == pytest.approx(np.radians(10.0))


def test_predictions_begin_with_the_truth_and_follow_it(tmp_path: Path) -> None:
    path = tmp_path / "push.h5"
    collect("push", path, episodes=1, workers=1, subtask="push", seed=5)
    found = predicted_episode(path, 0)
    with EpisodeFile(path) as file:
        known, qpos = file.attributes(0), file.episode(0, ["qpos"])["qpos"]
    true = visible.poses(make("push").scene(known["subtask"], known["seed"]).model, qpos)
    assert found["geoms/pos"].shape == true["geoms/pos"].shape
    np.testing.assert_allclose(found["geoms/pos"][0], true["geoms/pos"][0], atol=1e-6)
    apart = np.linalg.norm(found["geoms/pos"] - true["geoms/pos"], axis=-1)
    assert 0 < apart[:30].max() < 0.05

    def noisy(every: bool, seed: int = 0) -> np.ndarray:
        noise = StateNoise(0.01, 0.0, every, seed)
        return predicted_episode(path, 0, RECORDED, noise=noise)["geoms/pos"]

    exact = predicted_episode(path, 0, RECORDED)["geoms/pos"]
    np.testing.assert_array_equal(exact, true["geoms/pos"])
    np.testing.assert_array_equal(noisy(False), exact)  # nothing is predicted from its first state
    off = np.linalg.norm(noisy(True) - exact, axis=-1).max(-1)
    assert (off > 1e-4).all()
    np.testing.assert_array_equal(noisy(True), noisy(True))
    assert np.any(noisy(True) != noisy(True, seed=1))
