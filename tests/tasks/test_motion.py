"""Motions of an end effector as actions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from orbisim.tasks.arm import UR5E, ArmController
from orbisim.tasks.motion import CLOSED, OPEN, Director, Hold, Move, nearest_turn, wander

STEP = 0.05
START = (0.45, 0.0, 0.25)


@pytest.fixture(scope="module")
def arm() -> ArmController:
    return ArmController(UR5E)


def followed(arm: ArmController, *plan: Move | Hold, steps: int = 40) -> np.ndarray:
    """[steps+1, 4]: commanded position and gripper."""
    arm.solve(START, 0.0)
    director = Director(iter(plan), arm, 0.0, STEP)
    path = [[*arm.pos, CLOSED]]
    for _ in range(steps):
        action = director.action()
        arm.step(action)
        path.append([*arm.pos, action[6]])
    return np.array(path)


def test_a_move_arrives_within_its_speed_and_acceleration(arm: ArmController) -> None:
    goal = (0.45, 0.15, 0.25)
    path = followed(arm, Move(goal, speed=0.3, accel=2.0))[:, :3]
    np.testing.assert_allclose(path[-1], goal, atol=0.005)
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / STEP
    assert 0.25 < speeds.max() < 0.33
    assert np.abs(np.diff([0.0, *speeds])).max() < 2.0 * STEP * 2.5  # it may brake at the end
    assert np.abs(path[:, 0] - 0.45).max() < 0.003  # straight


def test_a_plan_is_asked_for_its_next_segment_when_one_is_done(arm: ArmController) -> None:
    grips = followed(arm, Hold(3), Hold(2, grip=OPEN), Hold(4), steps=12)[1:, 3]
    assert grips.tolist() == [CLOSED] * 3 + [OPEN] * 9


def test_after_the_last_segment_it_stays(arm: ArmController) -> None:
    path = followed(arm, Move((0.45, 0.05, 0.25)), steps=60)
    np.testing.assert_allclose(path[-1], path[-20], atol=1e-4)


def test_it_turns_the_tool(arm: ArmController) -> None:
    arm.solve(START, 0.0)
    director = Director(iter([Move(START, yaw=0.6)]), arm, 0.0, STEP)
    before = arm.rot.copy()
    for _ in range(15):
        arm.step(director.action())
    turn = arm.rot @ before.T
    assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(0.6, abs=0.02)


def test_wandering_stays_in_its_box() -> None:
    low, high = np.array([0.3, -0.2, 0.1]), np.array([0.6, 0.2, 0.3])
    moves = list(itertools.islice(wander(np.random.default_rng(0), low, high), 200))
    places = np.array([move.pos for move in moves])  # type: ignore[union-attr]
    assert (places >= low).all()
    assert (places <= high).all()
    assert (np.ptp(places, axis=0) > 0.9 * (high - low)).all()
    assert {move.grip for move in moves} == {None, OPEN, CLOSED}


@pytest.mark.parametrize(
    ("yaw", "period", "around", "expected"),
    [(3.0, np.pi, 0.0, 3.0 - np.pi), (0.2, np.pi / 2, 0.0, 0.2), (0.0, np.pi, 7.0, 2 * np.pi)],
)
def test_the_nearest_equal_turn(yaw: float, period: float, around: float, expected: float) -> None:
    assert nearest_turn(yaw, period, around) == pytest.approx(expected)
