"""Frequencies at which a missing force is looked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.regressors import MotionView, _frequency_grid
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.testing import inject_effect


@pytest.mark.parametrize("travel", [1e-13, 1e-3, 0.1, 2.0, 40.0])
def test_they_are_few_however_little_a_joint_moves(travel: float) -> None:
    grid = _frequency_grid(np.linspace(0.3, 0.3 + travel, 50), "position")
    assert 0 < len(grid) < 4000
    assert grid[0] * travel >= 0.99 * np.pi / 2  # a quarter of a period at least


def test_a_joint_at_rest_has_none() -> None:
    assert len(_frequency_grid(np.full(20, 0.1), "position")) == 0
    assert len(_frequency_grid(np.zeros(0), "time")) == 0


def test_a_motion_is_seen_with_the_declared_drives() -> None:
    """Along the intervals of an explanation in which two drives lag, and so have a state each."""
    arm = orbisim.load_scene(Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml")
    values = {"time_constant": 0.02}
    lags = [EffectInstance("actuator_lag", name, values) for name in ("shoulder", "elbow")]
    runs = inject_effect(arm, lags, duration=1.0, episodes=1, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    flow = bench.flow(Hypothesis(tuple(lags)))
    assert flow.act.shape[1] == 2 and arm.model.na == 0
    seen = MotionView(flow, bench.samples)
    plain = MotionView(bench.flow(Hypothesis()), bench.samples)
    np.testing.assert_allclose(seen.qfrc_actuator, plain.qfrc_actuator)
