"""Noise of sensors and drives, told apart from a force that a scene lacks."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.host.deadline import Deadline, TimeIsUpError
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.shooting.bench import make_bench
from orbisim.shooting.disturbances import (
    LASTING,
    Stretches,
    _Model,
    likeliest,
    remainder,
    stretches,
)
from orbisim.testing import inject_effect

NOISE = 1e-3


def _changed(
    recording: Recording, change: Callable[[str, np.ndarray, np.random.Generator], np.ndarray]
) -> Recording:
    rng = np.random.default_rng(len(recording.source))
    signals = {n: change(n, np.array(v), rng) for n, v in recording.signals.items()}
    return recording.replace(signals=signals)


def _stretches(scene: orbisim.Scene, runs: list[Recording]) -> Stretches:
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    found = stretches(bench.samples, bench.intervals, bench.noise)
    assert found is not None
    return found


def _runs(scene: orbisim.Scene, effects: list[EffectInstance]) -> list[Recording]:
    return inject_effect(
        scene, effects, duration=4.0, episodes=2, noise=NOISE, seed=6, velocities=False
    )


def _lasting(name: str, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """With noise of twice the white one's size, correlated over four samples."""
    if not name.startswith("qpos"):
        return values
    decay = np.exp(-1 / 4)
    added = np.zeros_like(values)
    added[0] = rng.normal(size=values.shape[1:])
    for k in range(1, len(values)):
        fresh = rng.normal(size=values.shape[1:])
        added[k] = decay * added[k - 1] + np.sqrt(1 - decay**2) * fresh
    return values + 2 * NOISE * added


def test_score_has_its_gradient() -> None:
    """By finite differences, with a sample that is missing."""
    rng = np.random.default_rng(0)
    A = np.tile(np.array([[1.0, 0.01], [-0.05, 0.98]]), (3, 20, 1, 1))
    B = np.tile(np.array([[1e-4], [0.02]]), (3, 20, 1, 1))
    y = 0.01 * rng.normal(size=(3, 21, 1))
    y[0, 3] = np.nan
    data = Stretches(
        A, B, 1e-3 * rng.normal(size=(3, 20, 2)), y, np.array([0]), np.array([0.01]),
        np.array([0.01, 0.1]), np.ones(1),
    )  # fmt: skip
    model = _Model(data, True)
    variances = np.array([1e-4, 2e-4, 3e-4, 0.3, 0.2])
    slope = model.score(variances)[1]
    for k in range(len(variances)):
        step = np.zeros(len(variances))
        step[k] = 1e-4 * variances[k]
        ends = [model.score(variances + s * step)[0].sum() for s in (1, -1)]
        assert slope[k] == pytest.approx((ends[0] - ends[1]) / (2 * step[k]), rel=1e-5, abs=1e-6)


def test_score_is_the_likelihood_of_all_samples_together() -> None:
    """The filter's score against the normal density of the stacked samples."""
    rng = np.random.default_rng(1)
    count, decay = 6, np.exp(-1 / np.array(LASTING))
    A = np.array([[1.0, 0.1], [0.0, 1.0]])
    B = np.array([[0.0], [0.1]])
    y = rng.normal(size=(1, count + 1, 1))
    data = Stretches(
        np.tile(A, (1, count, 1, 1)), np.tile(B, (1, count, 1, 1)), np.zeros((1, count, 2)), y,
        np.array([0]), np.array([0.5]), np.array([0.3, 0.4]), np.ones(1),
    )  # fmt: skip
    white, short, long, push = 0.25, 0.5, 0.7, 0.9
    found = _Model(data, False).score(np.array([white, short, long, push]))[0]
    read = np.array([(np.linalg.matrix_power(A, k))[0] for k in range(count + 1)])
    covariance = read @ np.diag((10 * data.size) ** 2) @ read.T + white * np.eye(count + 1)
    apart = np.abs(np.subtract.outer(np.arange(count + 1), np.arange(count + 1)))
    covariance += short * decay[0] ** apart + long * decay[1] ** apart
    for j in range(count):  # a push in interval j moves all samples after it
        moved = np.array([(np.linalg.matrix_power(A, k - j - 1) @ B)[0, 0] if k > j else 0.0
                          for k in range(count + 1)])  # fmt: skip
        covariance += push * np.outer(moved, moved)
    values = y.ravel()
    expected = -0.5 * (
        np.linalg.slogdet(covariance)[1]
        + values @ np.linalg.solve(covariance, values)
        + (count + 1) * np.log(2 * np.pi)
    )
    assert found[0] == pytest.approx(expected, rel=1e-9)


def test_white_noise_is_all_there_is(arm: orbisim.Scene) -> None:
    found = likeliest(_stretches(arm, _runs(arm, [])))
    np.testing.assert_allclose(found.white, NOISE, rtol=0.15)
    assert (found.lasting < 0.5 * NOISE).all()


def test_noise_that_lasts_is_noise(arm: orbisim.Scene) -> None:
    """Its size is known, and no force is asked for it."""
    runs = [_changed(one, _lasting) for one in _runs(arm, [])]
    found = remainder(_stretches(arm, runs))
    assert not found.structured
    size = np.sqrt((found.noise.lasting**2).sum(axis=0))
    np.testing.assert_allclose(size, 2 * NOISE, rtol=0.35)
    said = found.said(["shoulder", "elbow"], 0.01)
    assert "noise of qpos/shoulder of 0.00" in said and "force" not in said


def test_a_missing_force_is_no_noise(arm: orbisim.Scene) -> None:
    """Dry friction and a spring, under noise that lasts."""
    for effect in (
        EffectInstance("coulomb_friction", "elbow", {"torque": 0.1}),
        EffectInstance("joint_spring", "shoulder", {"stiffness": 1.0, "rest_position": 0.3}),
    ):
        lasting = [_changed(one, _lasting) for one in _runs(arm, [effect])]
        assert remainder(_stretches(arm, lasting)).structured, effect


def test_random_forces_are_no_larger_than_the_drive(arm: orbisim.Scene) -> None:
    """Friction that only a push could make up for, without one in its place."""
    dry = EffectInstance("coulomb_friction", "elbow", {"torque": 0.3})
    data = _stretches(arm, _runs(arm, [dry]))
    assert (data.drive > 0.05).all()
    free = likeliest(data)
    weak = likeliest(dataclasses.replace(data, drive=np.array([0.01, 0.0])))
    assert free.push[1] > 0.05
    assert weak.push[0] <= 0.01 * (1 + 1e-9) and weak.push[1] <= 1e-3 * data.unit[1]
    assert weak.score.sum() < free.score.sum()


def test_recordings_that_are_too_short_tell_nothing(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], duration=0.2, episodes=3, noise=NOISE, seed=6)
    bench = make_bench(arm, prepare_all(runs, arm), 0.1)
    assert stretches(bench.samples, bench.intervals, bench.noise) is None


def test_time_may_be_up(arm: orbisim.Scene) -> None:
    with pytest.raises(TimeIsUpError):
        likeliest(_stretches(arm, _runs(arm, [])), deadline=Deadline(0.0))
