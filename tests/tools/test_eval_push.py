"""C MuJoCo beside itself, from starts that are disturbed or not."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from orbisim_world_model.pack import Pack
from orbisim_world_model.packing import read_data

from orbisim.tasks.collect import collect

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import eval_push


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Pack:
    path = tmp_path_factory.mktemp("push") / "push.h5"
    collect("push", path, episodes=2, seed=1, workers=1)
    return read_data([path])


def test_an_undisturbed_start_gives_the_episode_itself(pack: Pack) -> None:
    found = eval_push.floor(pack, 60, 0.0)
    assert found["cube_position"]["worst"] < 0.01 and found["ghosts"] == 0
    assert found["energy"]["within"] == 1.0


def test_a_disturbed_start_shows(pack: Pack) -> None:
    found = eval_push.floor(pack, 60, 1.0)
    assert found["cube_position"]["median"] > 0.2
    deep = found["penetration_mm"]["mujoco"]["cubes"]["worst"]
    assert deep == eval_push.floor(pack, 60, 0.0)["penetration_mm"]["mujoco"]["cubes"]["worst"]
