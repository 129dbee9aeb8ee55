"""C MuJoCo beside itself, from starts that are disturbed or not."""

from __future__ import annotations

import sys
from pathlib import Path

from orbisim_world_model.pack import Pack

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import eval_push


def test_an_undisturbed_start_gives_the_episode_itself(pushes: Pack) -> None:
    found = eval_push.floor(pushes, 60, 0.0)
    assert found["cube_position"]["worst"] < 0.01 and found["ghosts"] == 0
    assert found["energy"]["within"] == 1.0


def test_a_disturbed_start_shows(pushes: Pack) -> None:
    found = eval_push.floor(pushes, 60, 1.0)
    assert found["cube_position"]["median"] > 0.2
    deep = found["penetration_mm"]["mujoco"]["cubes"]["worst"]
    assert deep == eval_push.floor(pushes, 60, 0.0)["penetration_mm"]["mujoco"]["cubes"]["worst"]
