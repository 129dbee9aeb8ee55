"""Comparisons say when an engine does not do its work."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import load_scene, make_backend
from orbisim.agreement import EngineWarning, faults_of_rollout
from orbisim.compare import compare
from orbisim.episodes import Episodes
from tests.agreement.engines import FALLING, STAND, Blind, Frozen, Rounded, loaded


def test_faults_of_all_worlds_are_one_line() -> None:
    scene = load_scene(FALLING)
    engine = loaded(Blind, scene, 4)
    trajectory = engine.rollout(engine.reset(), np.zeros((5, 0)))
    (text,) = faults_of_rollout(engine, trajectory, 1)
    assert text.startswith("in 4 of 4 episodes")
    assert "'box'" in text
    right = loaded(Rounded, scene, 4)
    assert not faults_of_rollout(right, right.rollout(right.reset(), np.zeros((5, 0))), 1)


def test_compare_warns_and_reports() -> None:
    scene = load_scene(FALLING)
    with pytest.warns(EngineWarning, match="nothing accelerates"):
        result = compare(scene, "mujoco", Frozen(), count=2, horizon=0.1)
    assert len(result.faults) == 1
    assert result.to_json()["faults"] == list(result.faults)


def test_compare_with_warp_names_the_pair() -> None:
    pytest.importorskip("mujoco_warp")
    with pytest.warns(EngineWarning, match="'base' and 'stand'"):
        scene = load_scene(STAND)
        initial = make_backend("mujoco", scene).reset(2)
        compare(Episodes(scene, initial), "mujoco", "warp", horizon=0.02)
