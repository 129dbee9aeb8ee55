"""The scripted policies do what they are for, most of the time."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import tasks
from orbisim.tasks.tabletop import on_table


def rate(name: str, subtask: str, count: int) -> float:
    task = tasks.make(name)
    return float(np.mean([bool(task.episode(subtask, 100 + i).success) for i in range(count)]))


@pytest.mark.parametrize(
    ("name", "subtask", "least"),
    [
        ("push", "to_hit", 0.8),
        ("push", "three", 0.7),
        ("push_cubes", "to_hit", 0.8),
        ("push_cubes", "towards_object", 0.7),
        ("pick_and_place", "stack", 0.6),
        ("pick_and_place", "unstack", 0.7),
        ("pick_and_place", "scattered", 0.7),
    ],
)
def test_success(name: str, subtask: str, least: float) -> None:
    assert rate(name, subtask, 10) >= least


def test_push_moves_the_cube_in_the_direction_it_was_asked_to() -> None:
    task = tasks.make("push")
    aligned = 0
    for seed in range(8):
        episode = task.episode("push", seed)
        cube = episode.arrays["objects/pos"][:, 0, :2]
        moved = cube[-1] - cube[0]
        tool = episode.arrays["robot/pos"][:, :2]
        low = episode.arrays["robot/pos"][:, 2] < 0.05
        stroke = tool[low][-1] - tool[low][0]
        cosine = moved @ stroke / (np.linalg.norm(moved) * np.linalg.norm(stroke))
        aligned += bool(cosine > 0.8 and np.linalg.norm(moved) > 0.03)
    assert aligned >= 6


def test_friction_changes_the_outcome_but_not_the_actions() -> None:
    slippery = tasks.make("push", table_friction=0.2).episode("to_hit", 8)
    rough = tasks.make("push", table_friction=0.6).episode("to_hit", 8)
    np.testing.assert_array_equal(slippery.arrays["action"], rough.arrays["action"])
    np.testing.assert_array_equal(slippery.arrays["ctrl"], rough.arrays["ctrl"])
    np.testing.assert_array_equal(slippery.arrays["qpos"][0], rough.arrays["qpos"][0])

    def slid(episode: tasks.Episode) -> float:
        cube = episode.arrays["objects/pos"][:, 1]
        return float(np.linalg.norm(cube[-1] - cube[0]))

    assert slid(slippery) > slid(rough)


@pytest.mark.parametrize("subtask", ["random", "push", "to_hit"])
def test_cubes_stay_on_the_table(subtask: str) -> None:
    task = tasks.make("push")
    ends = [task.episode(subtask, i).arrays["objects/pos"][-1] for i in range(6)]
    assert np.mean([on_table(end).all() for end in ends]) >= 0.8


def test_numbers_of_cubes_vary() -> None:
    task = tasks.make("push_cubes")
    counts = {task.scene("random", seed).model.nq for seed in range(8)}
    assert counts == {8 + 7 * 3, 8 + 7 * 4}


def test_settings_are_within_their_ranges() -> None:
    task = tasks.make("push", cube_half=(0.021, 0.022), density=400.0)
    for seed in range(4):
        model = task.scene("to_hit", seed).model
        for name in ("cube1", "cube2"):
            half = model.geom(name).size[0]
            assert 0.021 <= half <= 0.022
            assert model.body(name).mass[0] == pytest.approx(400.0 * (2 * half) ** 3)


def test_cubes_rest_from_the_start() -> None:
    episode = tasks.make("push").episode("to_hit", 1)
    assert np.abs(episode.arrays["objects/linvel"][:5]).max() < 1e-4
