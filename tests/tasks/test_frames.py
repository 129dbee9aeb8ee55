"""Camera images of episodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene, make_renderer
from orbisim.errors import InputError, RenderingUnavailableError, UnknownNameError
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.frames import Camera, check_camera


def test_frames(tmp_path: Path) -> None:
    try:
        make_renderer("mujoco", load_scene("task:ball"))
    except RenderingUnavailableError:
        pytest.skip("no OpenGL")
    path = tmp_path / "seen.h5"
    collect("ball", path, episodes=1, workers=1, camera=Camera("side", 48))
    with EpisodeFile(path) as episodes:
        frames = episodes.episode(0)["frames/side"]
    assert frames.shape == (37, 48, 48, 3)
    assert frames.std() > 5
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 30


@pytest.mark.parametrize("size", [7, 2049])
def test_sizes_out_of_range(size: int) -> None:
    with pytest.raises(InputError, match=f"8 to 2048 pixels; got {size}"):
        Camera("side", size)


def test_cameras_that_are_not_there() -> None:
    scene = load_scene("task:ball")
    check_camera(scene, Camera("side", 8))
    with pytest.raises(UnknownNameError, match="did you mean 'side'"):
        check_camera(scene, Camera("sied"))
