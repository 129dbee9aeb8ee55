"""Samples from stores: the paper's choice of frames, maps kept or computed, scopes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_diffusion.scope import read_scope, scene_concerns, scene_problem, view_problem
from orbisim_diffusion.store import draw_frames, load

from orbisim.cameras import Camera
from orbisim.errors import InputError
from orbisim.tasks.collect import collect
from tests.backends.diffusion.tiny import arm, store_of


def test_frames_are_of_one_episode_and_in_order() -> None:
    torch.manual_seed(0)
    store = store_of(arm(), frames=9, episodes=3)
    for context in (0, 3, 6):
        frames = draw_frames(store, 200, context, 0.5)
        assert frames.shape == (200, context + 1)
        episodes = store.episode[frames]
        assert (episodes == episodes[:, :1]).all()
        steps = frames.diff(dim=1)
        assert (steps >= 1).all()
        if context == 3:
            together = (steps == 1).all(1).float().mean()
            assert 0.5 <= float(together) < 0.8  # some of the others happen to be together, too
            assert len(frames[:, -1].unique()) > 10


def test_all_together_or_none() -> None:
    torch.manual_seed(0)
    store = store_of(arm(), frames=40)
    assert (draw_frames(store, 100, 4, 1.0).diff(dim=1) == 1).all()
    apart = (draw_frames(store, 100, 4, 0.0).diff(dim=1) == 1).all(1)
    assert apart.float().mean() < 0.1


@pytest.mark.parametrize("maps", ["geometry", "heatmaps"])
def test_maps_that_are_kept_are_those_that_are_computed(maps: str) -> None:
    store = store_of(arm(), frames=5)
    index = torch.tensor([4, 1])
    computed, tokens, there = store.conditions(index, maps)
    kept, _, _ = store.with_maps(maps).conditions(index, maps)
    torch.testing.assert_close(kept, computed, atol=5e-3, rtol=1e-2)
    assert computed.shape[0] == tokens.shape[0] == 2
    assert there.all()


def test_files_without_images_are_refused(tmp_path: Path) -> None:
    collect("toss", tmp_path / "toss.h5", episodes=1, workers=1)
    with pytest.raises(InputError, match="has no images"):
        load([tmp_path / "toss.h5"], torch.device("cpu"))


def test_a_scope_knows_its_scene_and_camera() -> None:
    store = store_of(arm(), episodes=2)
    scope = read_scope(store)
    rows = store.geoms[0].numpy().astype(np.float64)
    assert scene_problem(scope, rows) == ""
    assert scene_concerns(scope, rows) == []
    larger = rows.copy()
    larger[-1, 1:4] *= 2
    assert "trained on" in scene_concerns(scope, larger)[0]
    ball = rows.copy()
    ball[-1, 0] = 2
    assert "geom type 2" in scene_problem(scope, ball)
    pos = store.view_pos[0].double().numpy()
    assert view_problem(scope, Camera(pos + 1.0, np.eye(3), (1.2, 1.2))).startswith("the camera")
