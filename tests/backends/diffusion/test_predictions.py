"""Predicted poses of the geoms of an episode begin with the true ones and stay near them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from orbisim_diffusion.predictions import predicted_episode

from orbisim.scene import visible
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make


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
