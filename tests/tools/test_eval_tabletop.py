"""Figures of learned table-top episodes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from orbisim_world_model.entities import Entities

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "tools"))

import eval_tabletop


def states(steps: int, episodes: int, shift: float = 0.0) -> Entities:
    shape = (steps, episodes, 2)
    quat = torch.zeros(*shape, 4)
    quat[..., 0] = 1.0
    pos = torch.zeros(*shape, 3)
    pos[..., 0] = shift
    flat, hand = torch.zeros(steps, episodes, 0), torch.zeros(steps, episodes, 18)
    return Entities(flat, flat, flat, hand, pos, quat, torch.zeros_like(pos), torch.zeros_like(pos))


def test_errors_are_means_over_the_cubes_that_are_there() -> None:
    truth, predicted = states(20, 2), states(20, 2, 0.004)
    predicted.pos[:, 1, 1] = 100.0  # of a cube that the second episode has not
    mask = torch.tensor([[1.0, 1.0], [1.0, 0.0]])
    found = eval_tabletop.figures(
        predicted, truth, mask, states(21, 2), lambda e, cubes: len(cubes) == 21, [True, False]
    )
    assert set(found) == {"10", "20", "success"}  # the end, and the horizons before it
    assert np.isclose(found["20"]["position_mm"]["worst"], 4.0)
    assert found["success"]["right"] == 0.5 and found["success"]["truth"] == 0.5
    assert found["success"]["right_where_it_succeeds"] == 1.0
    assert found["success"]["right_where_it_fails"] == 0.0


def test_tables_have_a_row_for_each_horizon() -> None:
    figures = eval_tabletop.figures(
        states(20, 1), states(20, 1), torch.ones(1, 2), states(21, 1), None, [None]
    )
    rows = eval_tabletop.table({"push_test": {"episodes": 1, "one": figures}})
    assert [row.split(" | ")[:3] for row in rows] == [
        ["| push_test", "one", "10"],
        ["| push_test", "one", "20"],
    ]
