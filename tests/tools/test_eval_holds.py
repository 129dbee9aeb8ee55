"""What is said of rollouts that fail: failures without a word, and what intervals cover."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import eval_holds

WORLDS, STEPS, CUBES = 4, 3, 2


def _run(**changes: Any) -> dict[str, Any]:
    """Four rollouts of three steps with a robot and two cubes."""
    never = np.full((WORLDS, 1 + CUBES), np.inf)
    interval = np.full((WORLDS, STEPS, 1 + CUBES, 2), 1e-3)
    nothing = np.full(WORLDS, -1)
    return {"interval": interval, "diverged_at": nothing, "outside_at": never, **changes}


def test_shares_of_cubes_within_their_intervals() -> None:
    place, turn = np.zeros((WORLDS, STEPS + 1, CUBES)), np.zeros((WORLDS, STEPS + 1, CUBES))
    run = _run()
    run["interval"][:, 1, 0] = 0.0  # the robot's does not count
    run["interval"][:, 1, 1:, 1] = 0.1
    place[0, 2] = 2e-3
    place[1, 2, 0] = np.nan  # diverged
    turn[2, 2, 1] = 0.2
    place[:, 3] = 1.0  # of another step
    assert eval_holds.covered(run["interval"], place, turn, 2) == [5 / 8, 7 / 8]
    assert eval_holds.covered(run["interval"], place, turn, 3) == [0.0, 1.0]
    assert eval_holds.covered(None, place, turn, 2) is None


def test_a_failure_is_silent_unless_something_was_said_by_then() -> None:
    failed = np.zeros((WORLDS, STEPS + 1), bool)
    failed[:3, 2:] = True  # the last one does not fail
    run = _run()
    assert eval_holds.silent(run, failed, None, None, None).tolist() == [True, True, True, False]
    run["interval"][0, 1, 2, 1] = 0.4  # rad, after the second step
    run["interval"][1, 2, 2, 0] = 1.0  # too late
    run["outside_at"] = run["outside_at"].copy()
    run["outside_at"][2, 0] = 2.0
    assert eval_holds.silent(run, failed, None, None, None).tolist() == [False, True, False, False]
    run["diverged_at"] = np.array([-1, 1, -1, -1])
    assert not eval_holds.silent(run, failed, None, None, None).any()
