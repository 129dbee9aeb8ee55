"""Windows of late sensors, starts that are moved together, and windows that count less."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.bench import Bench, Hypothesis, make_bench, wrongly_lost
from orbisim.diagnosis.fits import Hints
from orbisim.diagnosis.gauss_newton import Problem
from orbisim.diagnosis.refine import Judge
from orbisim.diagnosis.shooting import Shooter, Variant
from orbisim.diagnosis.windows import Windows
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.testing import inject_effect

LATE = EffectInstance("sensor_delay", "shoulder", {"delay": 0.08})


@pytest.fixture(scope="module")
def bench(arm: orbisim.Scene) -> Bench:
    """Recordings in which one joint is read late."""
    runs = inject_effect(arm, [LATE], duration=4.0, episodes=3, noise=2e-4, seed=3)
    return make_bench(arm, prepare_all(runs, arm), 0.5)


def test_a_late_sensor_is_predicted_to_within_the_noise(bench: Bench) -> None:
    judge = Judge(bench, bench.intervals)
    held = Hypothesis((LATE,), frozen=frozenset({(0, "delay")}))
    judged, declared = judge.judge(held), judge.judge(Hypothesis())
    assert judged is not None
    assert declared is not None
    assert judged.ratio < 1.1
    assert declared.ratio > 5
    found = judge.judge(Hypothesis((LATE.replace(delay=0.03),)))
    assert found is not None
    assert found.hypothesis.effects[0].values["delay"] == pytest.approx(0.08, rel=0.01)


def test_states_of_late_sensors_are_those_that_were_simulated(bench: Bench) -> None:
    """Within the windows, whatever was simulated before; here the sensor is hardly late."""
    shooter = bench.shooter(bench.fit)
    assert shooter.room().any()
    assert not shooter.room().all()  # recordings do not go back for ever
    late = Hypothesis((LATE.replace(delay=1e-9),)).variant(bench.scene)
    start = np.zeros((len(shooter), 2 * shooter.nv))
    qpos, qvel = shooter.states(late, start)
    assert qpos.shape == shooter.qpos.shape
    seen = shooter.simulate(late, start)
    at_once = np.array([shooter.difference(r, q) for r, q in zip(shooter.qpos, qpos, strict=True)])
    read = seen[:, 1:, : shooter.nv]  # what was before a recording is not known
    np.testing.assert_allclose(read, at_once[:, 1:], atol=1e-6)
    assert np.isfinite(qvel).all()


def test_simulation_does_not_begin_before_a_gap(bench: Bench) -> None:
    shooter = bench.shooter(bench.fit)
    gap = int(shooter.row[1]) - 3
    late = [dataclasses.replace(s, time=s.time + (np.arange(len(s)) >= gap)) for s in bench.samples]
    gapped = Shooter(bench.scene, late, bench.intervals, shooter.windows, bench.noise)
    after = (shooter.row >= gap) & (shooter.row < gap + shooter.lead)
    assert (after & shooter.room()).any()
    np.testing.assert_array_equal(gapped.room(), shooter.room() & ~after)


def test_starts_that_are_moved_together_are_moved_one_by_one(bench: Bench) -> None:
    shooter, variant = bench.shooter(bench.fit), Variant(bench.scene)
    start = np.random.default_rng(0).normal(0, 1e-3, (len(shooter), 2 * shooter.nv))
    which = np.array([2, 0])
    every = shooter.moved(variant, start, 1e-3, which)
    for column, runs in enumerate(every):
        moved = start.copy()
        moved[:, column] += 1e-3
        np.testing.assert_array_equal(runs, shooter.simulate(variant, moved)[which])
    assert shooter.moved(variant, start, 1e-3, np.array([], int)).shape[1] == 0


def test_a_window_that_nothing_explains_does_not_outweigh_all_others() -> None:
    shooter: Any = SimpleNamespace(data=np.array([100, 100, 100]))
    cost = np.array([100.0, 400.0, 1e7])
    trial: Any = SimpleNamespace(cost=cost, total=float(cost.sum()) + 1.0, penalty=1.0)

    def problem(lenient: float) -> Problem:
        return Problem(shooter, lambda _: Variant(None), [], Hints(lenient=lenient), None)  # type: ignore[arg-type]

    assert problem(0.0).total(trial) == trial.total
    np.testing.assert_array_equal(problem(0.0).trust(cost), 1.0)
    trust = problem(4.0).trust(cost)
    assert trust[0] == pytest.approx(0.8)
    assert trust[1] == pytest.approx(0.5)
    assert trust[2] * cost[2] < 500  # of ten millions
    slope = (problem(4.0).total(_grown(trial, 1)) - problem(4.0).total(trial)) / 1e-3
    assert slope == pytest.approx(trust[1], rel=1e-3)  # what weighs is how the total changes


def _grown(trial: Any, window: int) -> Any:
    cost = trial.cost.copy()
    cost[window] += 1e-3
    return SimpleNamespace(cost=cost, total=float(cost.sum()) + 1.0, penalty=1.0)


class _Far(SimpleNamespace):
    """What a shooter is asked for windows that end early."""

    def __len__(self) -> int:
        return len(self.left)

    def simulate(self, variant: Variant, start: np.ndarray) -> None:
        assert start.shape == (len(self), 2)

    def residual(self, simulated: None) -> np.ndarray:
        return np.asarray(self.left)


def test_impacts_that_never_happened_cut_no_window_short() -> None:
    horizon = np.array([[10, 0], [3, 0], [2, 0], [4, 0]])
    windows = Windows(np.arange(4), 10, np.zeros(4, int), horizon)
    noise = (np.array([1e-3]), np.array([np.nan]))
    left = np.array([[1.0], [500.0], [300.0], [2.0]])
    shooter: Any = _Far(nv=1, declared=None, left=left)
    found = wrongly_lost(shooter, windows, noise)
    assert found.horizon is not None
    np.testing.assert_array_equal(found.horizon[:, 0], [10, 10, 10, 4])
    np.testing.assert_array_equal(found.horizon[:, 1], 0)  # no velocity is measured
    near: Any = _Far(nv=1, declared=None, left=left / 100)
    assert wrongly_lost(near, windows, noise) is windows
    few = dataclasses.replace(windows, horizon=np.array([[10, 0], [10, 0], [2, 0], [10, 0]]))
    assert wrongly_lost(shooter, few, noise) is few


def test_some_windows_are_simulated_as_all_are(bench: Bench) -> None:
    shooter, variant = bench.shooter(bench.fit), Variant(bench.scene)
    start = np.zeros((len(shooter), 2 * shooter.nv))
    only = np.zeros(len(shooter), bool)
    every = shooter.simulate(variant, start)
    assert not shooter.simulate(variant, start, only).any()
    only[[1, 3]] = True
    np.testing.assert_array_equal(shooter.simulate(variant, start, only)[only], every[only])
    twice = shooter.some(np.array([3, 3]))
    np.testing.assert_array_equal(twice.simulate(variant, start[[3, 3]]), every[[3, 3]])
