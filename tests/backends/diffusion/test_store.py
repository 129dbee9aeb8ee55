"""Samples from stores: the paper's choice of frames, maps kept or computed, scopes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
from orbisim_diffusion.conditions import (
    CONTROLS,
    MOST_GEOMS,
    STEPS,
    TOKEN_FEATURES,
    map_channels,
    one_token,
    token_features,
)
from orbisim_diffusion.config import Buffer, DenoiserConfig
from orbisim_diffusion.denoiser import Condition, Denoiser
from orbisim_diffusion.scope import read_scope, scene_concerns, scene_problem, view_problem
from orbisim_diffusion.store import Store, _assembled, draw_frames, load, tokens_of

from orbisim.cameras import Camera
from orbisim.errors import InputError
from orbisim.tasks.collect import collect
from tests.backends.diffusion.tiny import arm, episode_of, store_of


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


@pytest.mark.parametrize("maps", ["geometry", "heatmaps", "none"])
def test_maps_that_are_kept_are_those_that_are_computed(maps: str) -> None:
    store = store_of(arm(), frames=5)
    index = torch.tensor([4, 1])
    config = DenoiserConfig(maps=maps)  # type: ignore[arg-type]
    computed, tokens, there = store.conditions(index, config)
    kept, _, _ = store.with_maps(config).conditions(index, config)
    torch.testing.assert_close(kept, computed, atol=5e-3, rtol=1e-2)
    assert computed.shape[0] == tokens.shape[0] == 2
    assert there.all()


@pytest.mark.parametrize(
    ("buffer", "channels"),
    [
        ("colour", [0, 1, 2]),
        ("normals", [3, 4, 5]),
        ("depth", [6, 7, 8, 9]),  # position tells it, too
        ("instance", [10, 11, 12]),
        ("light", [13, 14]),
    ],
)
def test_a_buffer_that_is_left_out_is_no_input(buffer: Buffer, channels: list[int]) -> None:
    store, index = store_of(arm(), frames=5), torch.tensor([4, 1])
    config = DenoiserConfig(left_out=(buffer,))
    whole, tokens, there = store.conditions(index, DenoiserConfig())
    found, same, _ = store.conditions(index, config)
    torch.testing.assert_close(found, torch.tensor(np.delete(whole.numpy(), channels, axis=1)))
    torch.testing.assert_close(same, tokens)
    kept, _, _ = store.with_maps(config).conditions(index, config)
    torch.testing.assert_close(kept, found, atol=5e-3, rtol=1e-2)
    model = Denoiser(dataclasses.replace(config, widths=(16, 16), token=16, heads=2), 4)
    blank = torch.zeros(2, 4, 4, 4)
    given = Condition(blank[:, None][:, :0], blank, found, same, there)
    assert model(blank, torch.ones(2), given).shape == blank.shape
    with pytest.raises(RuntimeError, match="channels"):
        model(blank, torch.ones(2), given._replace(maps=whole))


def _repainted(store: Store) -> Store:
    return dataclasses.replace(store, geoms=_changed(store.geoms, slice(4, 7), 0.9))


def _relit(store: Store) -> Store:
    return dataclasses.replace(store, lights=_changed(store.lights, slice(0, 6), -0.7))


def _renamed(store: Store) -> Store:
    return dataclasses.replace(store, geoms=_changed(store.geoms, slice(7, 8), -1.0))


def _twice_as_large(store: Store) -> Store:
    """And seen from twice as far: the same image but for the depth."""
    poses = store.with_poses(2.0 * store.pos, store.quat)
    sizes, view = _changed(store.geoms, slice(1, 4), 2.0), 2.0 * store.view_pos
    return dataclasses.replace(poses, geoms=sizes, view_pos=view)


def _changed(rows: torch.Tensor, columns: slice, factor: float) -> torch.Tensor:
    found = rows.clone()
    found[..., columns] *= factor
    return found


@pytest.mark.parametrize(
    ("buffer", "change"),
    [
        ("colour", _repainted),
        ("light", _relit),
        ("instance", _renamed),
        ("depth", _twice_as_large),
    ],
)
def test_maps_do_not_change_with_what_only_a_buffer_that_is_left_out_shows(
    buffer: Buffer, change: Callable[[Store], Store]
) -> None:
    store, index = store_of(arm(), frames=3), torch.tensor([0, 2])
    if buffer == "depth":  # shadow rays start at a height in metres
        store = dataclasses.replace(store, lights=store.lights[:, :0])
    other = change(store)
    for left_out in [(), *((name,) for name in get_args(Buffer))]:
        config = DenoiserConfig(left_out=left_out)
        before, after = (s.conditions(index, config)[0] for s in (store, other))
        apart = float((before - after).abs().max())
        assert apart < 1e-3 if left_out == (buffer,) else apart > 0.05


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


def test_a_token_of_all_has_every_geoms_features_and_room_for_more() -> None:
    store, index = store_of(arm(), frames=3), torch.tensor([0, 2])
    _, each, there = store.conditions(index, DenoiserConfig())
    maps, one, present = store.conditions(index, DenoiserConfig(tokens="one"))
    assert one.shape == (2, 1, MOST_GEOMS * TOKEN_FEATURES)
    assert present.all()
    torch.testing.assert_close(one[:, 0, : each[0].numel()], each.flatten(1))
    assert not one[:, 0, each[0].numel() :].any()
    assert maps.shape[1] == map_channels(DenoiserConfig())
    with pytest.raises(InputError, match=f"at most {MOST_GEOMS}; got {MOST_GEOMS + 1}"):
        one_token(torch.zeros(1, MOST_GEOMS + 1, TOKEN_FEATURES), there[:1, :1])


def test_controls_are_those_that_led_to_a_frame_and_nothing_of_its_state() -> None:
    episodes = [episode_of(arm(), 4 + i, seed=i) for i in range(2)]
    for i, episode in enumerate(episodes):
        episode["ctrl"] = 10.0 * (i + 1) + np.arange(3 + i)[:, None] * np.ones((1, 2))
    store = _assembled(episodes, [0, 0], torch.device("cpu"))
    config = DenoiserConfig(maps="none", tokens="controls")
    maps, tokens, there = store.conditions(torch.tensor([0, 2, 4, 6]), config)
    assert not maps.any()
    assert tokens.shape == (4, STEPS, token_features(config))
    assert there.sum(1).tolist() == [1, 2, 1, 2]  # a first frame has an empty one
    assert not tokens[[0, 2]].any(-1)[:, 1:].any() and not tokens[[0, 2], 0, :CONTROLS].any()
    assert tokens[1, :3, 0].tolist() == [11.0, 10.0, 0.0]
    assert tokens[3, :3, 1].tolist() == [21.0, 20.0, 0.0]
    moved = store.with_poses(store.pos + 0.1, store.quat)
    torch.testing.assert_close(moved.conditions(torch.tensor([6]), config)[1], tokens[3:])
    with pytest.raises(InputError, match="some of these have none"):
        store_of(arm()).conditions(torch.tensor([0]), config)


def test_a_checkpoint_of_controls_shows_no_states() -> None:
    store, index = store_of(arm()), torch.tensor([0])
    with pytest.raises(InputError, match="not states"):
        tokens_of(store.solids(index), store.view(index), DenoiserConfig(tokens="controls"))
