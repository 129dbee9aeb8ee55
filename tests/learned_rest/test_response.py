"""Responses of windows to forces, against simulation."""

from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.learned_rest.response import affordable, responses
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.windows import Windows
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


def test_a_force_that_is_missing_explains_the_residual() -> None:
    """A constant torque at the elbow, once injected, leaves the noise if it is added."""
    arm = orbisim.load_scene(ARM)
    bias = EffectInstance("torque_bias", "elbow", {"offset": 0.02})
    runs = inject_effect(arm, [bias], duration=3.0, episodes=2, noise=1e-4, seed=2)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    found = responses(bench, Hypothesis(), bench.intervals, bench.windows, np.array([1]))
    force = np.full(found.gram.shape[1], 0.02 * arm.model.actuator_gear[1, 0])
    left = (
        found.square - 2 * found.moment @ force + np.einsum("i,wij,j->w", force, found.gram, force)
    )
    assert np.median(found.square / found.count) > 10
    assert np.median(left / found.count) == pytest.approx(1, abs=0.3)


def test_as_many_windows_as_memory_holds() -> None:
    many = Windows(np.arange(5000), 50, np.zeros(5000, int))
    assert affordable(many, 1).all()
    kept = affordable(many, 7)
    assert 8 <= kept.sum() < 5000 and kept[0] and kept[-1]
