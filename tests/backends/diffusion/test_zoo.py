"""The checkpoints that come with the package: small, and showing the scene as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_diffusion.estimate_physics import load_physics
from orbisim_diffusion.physics_data import Windows
from orbisim_diffusion.quality import psnr
from orbisim_diffusion.zoo import FOLDER
from orbisim_world_model.packing import read_data

from orbisim.errors import RenderingUnavailableError, UnsupportedSceneError
from orbisim.registry import make_backend, make_renderer
from orbisim.scene import load_scene
from orbisim.tasks.collect import collect
from orbisim.tasks.registry import make

_SIDE = {"camera": "side", "height": 128, "width": 128}


def test_all_of_them_together_are_small() -> None:
    sizes = [path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()]
    assert 0 < sum(sizes) <= 9e6


def test_an_episodes_start_is_shown_as_mujoco_shows_it() -> None:
    scene = make("push").scene("to_hit", 5)  # not one of the training's
    state = make_backend("mujoco", scene).reset(1).replace(qpos=scene.model.key("start").qpos[None])
    ours = make_renderer("diffusion", scene, device="cpu").render(state, **_SIDE)
    try:
        true = make_renderer("mujoco", scene).render(state, **_SIDE)
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    assert float(psnr(torch.tensor(ours), torch.tensor(true))) > 28.0
    assert np.abs(ours.astype(int) - true).max() > 0


def test_scenes_that_none_was_trained_on_are_refused() -> None:
    with pytest.raises(UnsupportedSceneError, match="no vision checkpoint of the zoo"):
        make_renderer("diffusion", load_scene("task:ball"), device="cpu")


def test_the_shipped_phyinf_reads_friction_off_pushes_and_says_no_density(tmp_path: Path) -> None:
    path = tmp_path / "push.h5"
    collect("push", path, episodes=12, workers=1, seed=31)
    windows = Windows(read_data([path]))
    network, _ = load_physics(FOLDER / "push")
    truth = windows.every(24)
    some = (windows.way(truth) > 0.05).any(1)  # m
    with torch.no_grad():
        said = network.said(windows.seen(truth, noisy=False))
    off = (said.mean - truth.logs)[some, 0].exp().sub(1.0).abs()
    prior = (network.prior[0, 0] - truth.logs)[some, 0].exp().sub(1.0).abs()
    assert len(off) >= 12 and float(off.median()) < 0.08 < 0.15 < float(prior.median())
    share = said.spread[:, 1:] / network.prior[1, 1]
    assert float(share.median()) > 0.9
