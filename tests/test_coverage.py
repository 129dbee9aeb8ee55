"""Predicted intervals are held against errors of the right frames, in the right way."""

from __future__ import annotations

import json

import numpy as np
import pytest

from orbisim import load_scene
from orbisim.backend import Intervals
from orbisim.coverage import coverage

SCENE = load_scene(
    "<mujoco><worldbody><body name='arm'><joint axis='0 0 1'/><geom size='.1'/>"
    "<site name='tip' pos='2 0 0'/></body><body name='box' pos='0 0 1'><freejoint/>"
    "<geom size='.1'/></body></worldbody></mujoco>"
)
FRAMES = (("site", "tip"), ("body", "box"))


def _intervals(position: float, rotation: float) -> Intervals:
    shape = (1, 2, 2)
    return Intervals(FRAMES, 0.9, np.full(shape, position), np.full(shape, rotation))


def test_errors_are_those_of_the_frames() -> None:
    """An arm of 2 m turned by 0.1 rad in the first state, a box moved by 5 m in the second."""
    truth = np.tile(SCENE.model.qpos0, (1, 2, 1))
    qpos = truth.copy()
    qpos[0, 0, 0] = 0.1
    qpos[0, 1, 1:3] += 3.0, 4.0
    found = coverage(SCENE.model, _intervals(0.5, 0.05), qpos, truth)
    np.testing.assert_allclose(found.position, [[[4 * np.sin(0.05), 0], [0, 5]]], atol=1e-9)
    np.testing.assert_allclose(found.rotation, [[[0.1, 0], [0, 0]]], atol=1e-7)
    assert found.held("position").tolist() == [[[1, 1], [1, 0]]]
    assert found.held("rotation").tolist() == [[[0, 1], [1, 1]]]


def test_what_has_no_error_is_not_counted() -> None:
    truth = np.tile(SCENE.model.qpos0, (1, 2, 1))
    lost = truth.copy()
    lost[0, 1] = np.nan
    found = coverage(SCENE.model, _intervals(0.5, 0.05), lost, truth)
    assert np.isnan(found.position[0, 1]).all() and np.isnan(found.held("position")[0, 1]).all()
    summary = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert summary["level"] == 0.9
    tip = summary["frames"][0]
    assert (tip["kind"], tip["name"]) == ("site", "tip")
    assert tip["position"]["covered"] == [1.0, None]
    assert tip["position"]["covered_in_all"] == 1.0
    assert tip["position"]["error"]["median"] == [0.0, None]
    assert tip["rotation"]["interval"]["p95"] == pytest.approx([0.05, 0.05])
