"""Noise that is told apart from the motion."""

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.testing import inject_effect


def test_noise_is_told_apart_from_a_missing_force(arm: orbisim.Scene) -> None:
    """Friction that the scene lacks is of slow course, and no noise."""
    dry = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    runs = inject_effect(arm, [dry], duration=4.0, episodes=2, noise=1e-3, seed=6)
    found = make_bench(arm, prepare_all(runs, arm), 0.5).noise
    np.testing.assert_allclose(found[0], 1e-3, rtol=0.15)


def test_what_is_not_measured_has_no_noise(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], duration=2.0, episodes=1, noise=1e-3, seed=6, velocities=False)
    q, v = make_bench(arm, prepare_all(runs, arm), 0.5).noise
    assert q == pytest.approx(1e-3, rel=0.3) and np.isnan(v).all()
