"""Noise that lasts for some samples, where bodies touch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.linear import extrapolated
from orbisim.motion.samples import Samples, prepare_all
from orbisim.recording import Recording
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.lasting import lasting_noise
from orbisim.shooting.noise import between_impacts, estimate_noise
from orbisim.testing import inject_effect
from tests.balls import in_long_steps

PUCK = Path(__file__).parents[2] / "mjcf_assets" / "gripper_push" / "scene.xml"
SIZE = 1e-3


def _noisy(runs: list[Recording], lost: float, seed: int) -> list[Recording]:
    """Positions alone, with noise that is lost over so many samples; white for none."""
    rng, found = np.random.default_rng(seed), []
    keep = np.exp(-1 / lost) if lost else 0.0
    for one in runs:
        signals = {}
        for name, values in one.signals.items():
            if name.startswith("qpos"):
                white = rng.normal(size=values.shape)
                noise = scipy.signal.lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0)
                signals[name] = values + SIZE * noise
            elif not name.startswith("qvel"):
                signals[name] = values
        found.append(one.replace(signals=signals))
    return found


def _bench(lost: float, effects: list[EffectInstance]) -> tuple[Bench, list[Samples]]:
    scene = orbisim.load_scene(PUCK)
    rate = 1 / (round(0.01 / scene.model.opt.timestep) * scene.model.opt.timestep)
    runs = inject_effect(scene, effects, rate=rate, episodes=6, duration=2.0, noise=0.0, seed=1)
    samples = prepare_all(_noisy(runs, lost, seed=5), scene)
    return make_bench(scene, samples, 0.5), samples


def _lasting(bench: Bench, samples: list[Samples]) -> npt.NDArray[np.float64]:
    stretches = between_impacts(samples, bench.intervals, bench.windows)
    assert stretches is not bench.windows
    exact = extrapolated(bench.flow(Hypothesis()), bench.intervals)
    return lasting_noise(samples, [bench.intervals, exact], stretches)


@pytest.mark.parametrize("lost", [2.0, 4.0])
def test_all_of_the_noise_is_seen(lost: float) -> None:
    """White noise of the same roughness is a half of it."""
    bench, samples = _bench(lost, [])
    assert bench.contacts
    stretches = between_impacts(samples, bench.intervals, bench.windows)
    white, _ = estimate_noise(samples, bench.intervals, stretches)
    assert np.nanmedian(white) < 0.75 * SIZE
    found = _lasting(bench, samples)
    assert np.nanmedian(found) == pytest.approx(SIZE, rel=0.3)
    assert np.nanmedian(bench.noise[0]) == pytest.approx(SIZE, rel=0.3)


def test_white_noise_and_a_missing_force_do_not_last() -> None:
    drag = EffectInstance("viscous_damping", "x", {"coefficient": 3.0})
    for effects in [], [drag]:
        bench, samples = _bench(0.0, effects)
        found = _lasting(bench, samples)
        assert np.isnan(found).all() or np.nanmedian(found) < 1.2 * SIZE
        np.testing.assert_allclose(np.nanmedian(bench.noise[0]), SIZE, rtol=0.2)


def test_a_step_that_is_too_long_is_no_noise() -> None:
    """In these steps it would be: most stretches gain by noise that lasts."""
    bench = in_long_steps()
    samples = list(bench.samples)
    assert np.isnan(_lasting(bench, samples)).all()
    stretches = between_impacts(samples, bench.intervals, bench.windows)
    assert np.isfinite(lasting_noise(samples, [bench.intervals], stretches)).all()


def test_nothing_is_known_of_what_is_not_there() -> None:
    bench, samples = _bench(2.0, [])
    none = bench.windows.some(np.zeros(0, np.int64))
    assert np.isnan(lasting_noise(samples, [bench.intervals], none)).all()
