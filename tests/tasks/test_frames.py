"""Images in episodes: depth, segmentation, camera and geoms agree with each other."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from orbisim import Scene, load_scene, make_renderer
from orbisim.errors import InputError, RenderingUnavailableError, UnknownNameError
from orbisim.scene import visible
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.episode import Episode
from orbisim.tasks.frames import RANDOM, Camera, check_camera, with_frames
from orbisim.tasks.registry import make

SIZE = 48


@pytest.fixture(scope="module")
def pushed() -> tuple[Episode, Scene]:
    """The first steps of a push, and its scene."""
    task = make("push")
    episode = task.episode("to_hit", 0)
    arrays = {
        name: array[:6] if len(array) == episode.steps + 1 else array
        for name, array in episode.arrays.items()
    }
    return dataclasses.replace(episode, arrays=arrays), task.scene("to_hit", 0)


@pytest.fixture(scope="module", params=["side", RANDOM])
def episode(
    request: pytest.FixtureRequest, pushed: tuple[Episode, Scene]
) -> Mapping[str, npt.NDArray[np.float64]]:
    try:
        found = with_frames(*pushed, Camera(request.param, SIZE))
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    return {name.replace(request.param, "camera"): array for name, array in found.arrays.items()}


def test_pixels_of_a_cube_are_points_of_the_cube(
    episode: Mapping[str, npt.NDArray[np.float64]],
) -> None:
    """Segmentation says which, depth and camera where, and the geoms' rows and poses agree."""
    geoms, inverse = (
        episode["descriptor/geoms"],
        np.linalg.inv(episode["descriptor/intrinsics/camera"]),
    )
    seen = 0
    for row, geom in enumerate(geoms):
        if geom[visible.COLUMNS.index("entity")] < 1:
            continue
        half = geom[1:4]
        number = geom[visible.COLUMNS.index("geom")]
        y, x = np.nonzero(episode["segmentation/camera"][5] == number)
        depth = episode["depth/camera"][5][y, x]
        rays = inverse @ np.stack([x + 0.5, y + 0.5, np.ones(len(x))])
        points = (rays * depth) * np.array([[1.0], [-1.0], [-1.0]])
        rot, pos = episode["cameras/camera/rot"][5], episode["cameras/camera/pos"][5]
        world = rot @ points + pos[:, None]
        distance = np.linalg.norm(world.T - episode["geoms/pos"][5, row], axis=1)
        assert (distance < np.linalg.norm(half) + 0.01).all()
        seen += len(x)
    assert seen > 5


def test_entities_of_geoms() -> None:
    model = make("push").scene().model
    rows = {model.geom(int(row[-1])).name: row for row in visible.rows(model)}
    entity = {name: row[visible.COLUMNS.index("entity")] for name, row in rows.items()}
    assert entity["table"] == visible.STATIC
    assert entity["forearm"] == visible.ROBOT
    assert (entity["cube1"], entity["cube2"]) == (1, 2)
    np.testing.assert_allclose(rows["cube1"][4:7], [0.8, 0.2, 0.2], atol=1e-6)


def test_boxes_that_are_no_cubes() -> None:
    task = make("push", aspect=(0.45, 0.65))
    size = task.scene("to_hit", 3).model.geom("cube1").size
    assert 0.45 <= size[1] / size[0] <= 0.65
    plain = make("push").scene("to_hit", 3).model.geom("cube1").size
    assert plain[0] == plain[1] == size[0]


def test_frames(tmp_path: Path) -> None:
    try:
        make_renderer("mujoco", load_scene("task:ball"))
    except RenderingUnavailableError:
        pytest.skip("no OpenGL")
    path = tmp_path / "seen.h5"
    collect("ball", path, episodes=1, workers=1, camera=Camera("side", 48))
    with EpisodeFile(path) as episodes:
        frames = episodes.episode(0)["frames/side"]
        assert episodes.columns("descriptor/geoms") == visible.COLUMNS
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
