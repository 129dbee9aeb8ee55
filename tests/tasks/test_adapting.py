"""Pieces of demonstrations in other layouts."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.adapting import Frame, Piece, bridge, commanded
from orbisim.tasks.arm import pointing_down

FRAME = Frame(np.array([0.5, 0.0, 0.02]), 0.2)
PIECE = Piece(
    "cube",
    FRAME,
    np.array([[0.5, 0.1, 0.2], [0.5, 0.05, 0.1], [0.5, 0.0, 0.02]]),
    np.array([pointing_down(yaw) for yaw in (0.0, 0.1, 0.2)]),
    np.array([-1.0, -1.0, 1.0]),
)


def test_a_piece_moves_with_its_object() -> None:
    moved = PIECE.moved(Frame(np.array([0.4, 0.2, 0.06]), 0.2 + 0.3), np.pi / 2)
    np.testing.assert_allclose(moved.pos[-1], [0.4, 0.2, 0.06], atol=1e-12)
    np.testing.assert_allclose(moved.rot[-1], pointing_down(0.5), atol=1e-12)
    away = [-0.1 * np.sin(0.3), 0.1 * np.cos(0.3), 0.18]
    np.testing.assert_allclose(moved.pos[0] - [0.4, 0.2, 0.06], away, atol=1e-12)


def test_the_smallest_turn_is_made() -> None:
    moved = PIECE.moved(Frame(FRAME.pos, 0.2 + np.pi / 2 - 0.1), np.pi / 2)
    np.testing.assert_allclose(moved.rot[-1], pointing_down(0.1), atol=1e-12)


def test_stretches_of_one_grip() -> None:
    first, second = PIECE.paths()
    assert (len(first.pos), first.grip, len(second.pos), second.grip) == (2, -1.0, 1, 1.0)


def test_actions_say_where_the_tool_is_sent() -> None:
    action = np.zeros((2, 7))
    action[:, 0], action[:, 5] = 0.01, 0.1
    pos, rot = commanded(action, np.zeros(3), pointing_down(0.0))
    np.testing.assert_allclose(pos[-1], [0.02, 0, 0])
    np.testing.assert_allclose(rot[-1], pointing_down(0.2), atol=1e-12)


def test_a_bridge_begins_and_ends_at_rest() -> None:
    start, end = (np.zeros(3), pointing_down(0.0)), (np.array([0.3, 0, 0]), pointing_down(0.5))
    way = bridge(start, end, 0.25, 0.05)
    steps = np.diff(np.concatenate([[0.0], way.pos[:, 0]]))
    assert len(way.pos) == 24 and steps[0] < 0.2 * steps.max() and steps[-1] < 0.2 * steps.max()
    np.testing.assert_allclose(way.pos[-1], end[0], atol=1e-12)
    np.testing.assert_allclose(way.rot[-1], end[1], atol=1e-12)
