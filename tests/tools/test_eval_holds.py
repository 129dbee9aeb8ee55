"""What is said of rollouts that fail: failures without a word, and what intervals cover."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from orbisim_world_model.pack import Pack

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
    assert eval_holds.covered(run["interval"], place, turn, 2, 2.0) == [7 / 8, 1.0]
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


def test_a_lower_limit_says_more_and_earlier() -> None:
    error = np.zeros((4, 5))
    error[0, 2:] = 1.5  # fails after the second step
    error[1, 4:] = 1.5
    width = np.zeros((4, 4, 2))
    width[0, 1, 0] = 0.6  # as it fails
    width[1, 0, 1] = 0.2  # long before
    width[2, 2, 0] = 0.6  # where nothing does
    said = np.array([np.inf, np.inf, np.inf, 4.0])
    signal = {"error": error, "width": width, "said": said}
    found = eval_holds.warned(signal, 4)
    assert found["failed"] == {"episodes": 2}
    assert found["1"] == {"silent": 2, "false": 1}  # what is said without intervals, of the last
    assert found["0.5"] == {"silent": 1, "false": 2}
    assert found["0.18"] == {"silent": 0, "false": 2}
    brief = eval_holds.warned(signal, 2)  # the second and the last are still good
    assert brief["failed"] == {"episodes": 1}
    assert brief["0.5"] == {"silent": 0, "false": 0}
    assert brief["0.18"] == {"silent": 0, "false": 1}


def test_an_interval_that_comes_after_the_failure_is_no_warning() -> None:
    signal = {"error": np.array([[0.0, 1.5, 1.5]]), "said": np.array([np.inf])}
    late = {**signal, "width": np.array([[[0.0], [2.0]]])}
    assert eval_holds.warned(late, 2)["1"] == {"silent": 1, "false": 0}
    there = {**signal, "width": np.array([[[2.0], [0.0]]])}
    assert eval_holds.warned(there, 2)["1"] == {"silent": 0, "false": 0}


def test_signals_are_relative_to_what_counts_as_failed() -> None:
    qpos = np.zeros((1, 3, 8 + 14))
    qpos[..., [11, 18]] = 1.0  # quaternions of both cubes
    found = qpos.copy()
    found[0, 1, 8 + 7] = 0.1  # m, the second cube
    found[0, 2, 3] = -0.025  # rad, a joint
    interval = np.array([[[[0.2, 0.0], [0.005, 0.0], [0.0, np.deg2rad(10.0)]]] * 2])
    run = {"truth": qpos, "found": found, "interval": interval}
    run |= {"diverged_at": np.array([-1]), "outside_at": np.array([[np.inf, 1.0, 2.0]])}
    signal = eval_holds.signals(run)
    np.testing.assert_allclose(signal["error"], [[0.0, 2.0, 0.5]])
    np.testing.assert_allclose(signal["width"], [[[4.0, 0.1, 0.5]] * 2])  # the hand's comes first
    assert signal["said"].tolist() == [1.0]
    assert eval_holds.signals({**run, "diverged_at": np.array([0])})["said"].tolist() == [1.0]
    assert eval_holds.signals({**run, "outside_at": None})["said"].tolist() == [np.inf]


def test_mujoco_from_the_true_start_repeats_it_and_from_another_does_not(pushes: Pack) -> None:
    some = pushes.subset(torch.arange(2))
    same = eval_holds.errors_of(eval_holds.simulated(some, 0.0))
    assert same.place[:, :30].max() < 1e-4  # m; single precision, before anything is touched
    other = eval_holds.errors_of(eval_holds.simulated(some, 1.0))
    assert 1e-4 < other.place[:, 0].max() < 5e-3
    assert same.arm[:, 0].max() == 0.0
