"""`task:push` does what it is for, most of the time."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import tasks
from orbisim.tasks.push import Stroke, behind, hit, inside, slide, within
from orbisim.tasks.tabletop import Pose, on_table


def rate(subtask: str, count: int = 5) -> float:
    task = tasks.make("push")
    return float(np.mean([bool(task.episode(subtask, 100 + i).success) for i in range(count)]))


@pytest.mark.parametrize(("subtask", "least"), [("to_hit", 0.8), ("three", 0.7)])
def test_success(subtask: str, least: float) -> None:
    assert rate(subtask) >= least


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


def test_a_stroke_goes_behind_the_cube_and_along_its_heading() -> None:
    stroke = Stroke((0.4, 0.1), np.pi / 3, 0.2, 0.5)
    assert stroke.end == pytest.approx(
        (0.4 + 0.2 * np.cos(np.pi / 3), 0.1 + 0.2 * np.sin(np.pi / 3))
    )
    above, down, _, push = stroke.segments()
    assert above.pos[:2] == down.pos[:2] == stroke.start  # type: ignore[union-attr]
    assert above.pos[2] > down.pos[2] == push.pos[2]  # type: ignore[union-attr]
    assert (push.pos[:2], push.speed) == (stroke.end, 0.5)  # type: ignore[union-attr]


@pytest.mark.parametrize(("turn", "reach"), [(0.0, 1.0), (np.pi / 4, np.sqrt(2)), (np.pi / 2, 1.0)])
def test_fingers_go_down_behind_the_face_that_they_push(turn: float, reach: float) -> None:
    x, y = behind(Pose((0.5, 0.0, 0.03), turn), 0.03, 0.0, clearance=0.02)
    assert x == pytest.approx(0.5 - (0.03 * reach + 0.011 + 0.02))
    assert y == pytest.approx(0.0)


def test_what_counts_as_a_hit() -> None:
    start = [[0.4, 0, 0.03], [0.5, 0, 0.03]]
    far, near = [[0.45, 0, 0.03], [0.56, 0, 0.03]], [[0.45, 0, 0.03], [0.54, 0, 0.03]]
    gone = [[0.45, 0, -0.5], [0.56, 0, 0.03]]
    assert [hit(np.array([start, end])) for end in (far, near, gone)] == [True, False, False]


def test_how_far_a_cube_slides_at_most() -> None:
    friction, speed = 0.2, 0.7
    assert slide(speed) == pytest.approx(speed**2 / (2 * friction * 9.81) + 0.03)


def test_where_the_arm_reaches_and_cubes_may_end() -> None:
    assert within((0.5, 0.1))
    for spot in ((0.2, 0.0), (0.9, 0.0), (0.2, 0.5)):
        assert not within(spot)
    assert inside(np.array([0.5, 0.3]))
    assert not inside(np.array([0.5, 0.4]))
