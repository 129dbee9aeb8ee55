"""Scenes with cubes on a table, drawn from ranges."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from orbisim.tasks.arm import UR5E
from orbisim.tasks.armtask import controller
from orbisim.tasks.staging import Script, opening_pose
from orbisim.tasks.tabletop import (
    Cube,
    Pose,
    Setting,
    TabletopConfig,
    build,
    draw_setting,
    on_table,
    scatter,
    tower,
)

CONFIG = TabletopConfig()


def setting(count: int, seed: int = 0) -> Setting:
    return draw_setting(CONFIG, count, np.random.default_rng(seed))


def test_numbers_are_drawn_from_their_ranges() -> None:
    drawn = [setting(3, seed) for seed in range(40)]
    for name, values in {
        "cube_half": [cube.half for one in drawn for cube in one.cubes],
        "density": [cube.density for one in drawn for cube in one.cubes],
        "cube_friction": [cube.friction for one in drawn for cube in one.cubes],
        "table_friction": [one.table_friction for one in drawn],
    }.items():
        low, high = getattr(CONFIG, name)
        assert low <= min(values) < low + 0.2 * (high - low), name
        assert high - 0.2 * (high - low) < max(values) <= high, name


@pytest.mark.parametrize("seed", range(5))
def test_cubes_do_not_touch_each_other(seed: int) -> None:
    one = setting(4, seed)
    poses = scatter(one, CONFIG, np.random.default_rng(seed), gap=0.03)
    for i, pose in enumerate(poses):
        assert CONFIG.x[0] <= pose.pos[0] <= CONFIG.x[1]
        for j in range(i):
            apart = np.linalg.norm(np.subtract(pose.pos[:2], poses[j].pos[:2]))
            assert apart > np.sqrt(2) * (one.cubes[i].half + one.cubes[j].half) + 0.03


def test_a_tower_stands() -> None:
    one = setting(4)
    poses = tower(one, CONFIG, np.random.default_rng(1), 3)
    heights = [pose.pos[2] for pose in poses]
    halves = [cube.half for cube in one.cubes]
    expected = halves[0], 2 * halves[0] + halves[1], 2 * (halves[0] + halves[1]) + halves[2]
    np.testing.assert_allclose(heights[:3], expected, atol=5e-4)
    assert heights[3] == pytest.approx(halves[3], abs=5e-4)
    for low, high in itertools.pairwise(poses[:3]):
        assert np.abs(np.subtract(low.pos[:2], high.pos[:2])).max() < 0.3 * 0.032


def test_a_pose_is_a_turn_about_the_vertical() -> None:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, Pose((1.0, 2.0, 3.0), 0.3).qpos[3:])
    c, s = np.cos(0.3), np.sin(0.3)
    np.testing.assert_allclose(matrix.reshape(3, 3), [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_scene_is_its_setting(count: int) -> None:
    cubes = tuple(
        Cube(0.02 + 0.002 * i, 300.0 + i, 0.3 + 0.1 * i, (0.1, 0.2, 0.3)) for i in range(count)
    )
    one = Setting(cubes, 0.45)
    poses = [Pose((0.4 + 0.08 * i, 0.0, 0.03), 0.0) for i in range(count)]
    script = Script(poses, (0.45, 0.0, 0.2), lambda stage: iter(()))
    pose = opening_pose(script, controller(UR5E))
    model = build("push", one, "label", *pose).model
    names = [
        model.body(b).name for b in range(model.nbody) if model.body(b).name.startswith("cube")
    ]
    assert names == [f"cube{i + 1}" for i in range(count)]
    assert model.geom("table").friction[0] == 0.45
    for name, cube in zip(names, cubes, strict=True):
        assert model.body(name).mass[0] == pytest.approx(cube.density * (2 * cube.half) ** 3)
        assert model.geom(name).friction[0] == cube.friction
        np.testing.assert_allclose(model.geom(name).rgba, [0.1, 0.2, 0.3, 1.0], rtol=1e-6)
    np.testing.assert_array_equal(model.key("start").qpos, pose[0])


def test_what_is_on_the_table() -> None:
    places = np.array([[0.5, 0.0, 0.02], [0.5, 0.0, -0.1], [1.0, 0.0, 0.02], [0.5, 0.5, 0.02]])
    assert on_table(places).tolist() == [True, False, False, False]
