"""Problems of identification, and one of them solved by each classical method."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from orbisim_world_model.pack import Pack

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import identify_push


def test_windows_are_those_in_which_a_cube_moves(pushes: Pack) -> None:
    problems = identify_push.cut(pushes, 20)
    assert problems
    for episode, problem in problems.items():
        np.testing.assert_allclose(problem.truth, identify_push.hidden(pushes)[episode])
        for grid in (problem.fit, problem.held):
            for start, ends in zip(grid.qpos, grid.target, strict=True):
                moves = (ends - start)[:, identify_push.CUBES :].reshape(len(ends), -1, 7)
                assert np.linalg.norm(moves[..., :3], axis=-1).max() >= identify_push.MOVES


def test_true_values_explain_what_is_held_out(pushes: Pack) -> None:
    problem = next(iter(identify_push.cut(pushes, 20).values()))
    problem = dataclasses.replace(problem, held=problem.fit)
    true = identify_push.slide(problem, problem.truth)
    wrong = identify_push.slide(problem, problem.truth * [3.0, 1.0])
    assert 2 * max(true) < max(wrong)


@pytest.mark.slow
def test_sysid_and_cma_bring_the_error_down(pushes: Pack) -> None:
    problem = next(iter(identify_push.cut(pushes, 20).values()))
    row = identify_push.one("sysid", problem, 6, None)
    assert row["low"][0] <= row["values"][0] <= row["high"][0]
    pytest.importorskip("cma")
    other = identify_push.one("cma", problem, 6, 3.0)
    assert other["processor_seconds"] < 30.0
    table = identify_push.summary({"rows": {"0": other}}, {0: problem})
    assert table["friction:table"]["error"][0] < table["friction:table"]["declared"][0]


def test_what_is_printed() -> None:
    assert identify_push._quantiles([]) == []
    assert identify_push._quantiles([1.0, 2.0, 3.0])[0] == 2.0
