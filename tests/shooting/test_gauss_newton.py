"""Steps of a fit, and what counts in it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.effects.measurement import Measurement
from orbisim.errors import SceneError
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.shooting.bench import make_bench
from orbisim.shooting.confidence import confidence
from orbisim.shooting.fits import Hints, Unknown
from orbisim.shooting.gauss_newton import Problem, gauss_newton, least_squares
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge
from orbisim.shooting.shooter import Variant
from orbisim.testing import inject_effect


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


@pytest.mark.filterwarnings(
    "ignore:.*overflow.*:RuntimeWarning", "ignore:.*invalid value.*:RuntimeWarning"
)
def test_slopes_that_overflow_move_nothing() -> None:
    """A motion that flies off has differences whose squares are no numbers; others step on."""
    shooter: Any = SimpleNamespace(data=np.array([4]))
    unknowns = [Unknown(name, 0.0, -10.0, 10.0, 1e-3) for name in ("a", "b")]
    problem = Problem(shooter, lambda _: Variant(None), unknowns, Hints(), None)  # type: ignore[arg-type]
    slopes = np.zeros((1, 4, 2))
    slopes[0, :, 0] = 1.0
    for flown in (1e200, np.inf):
        slopes[0, 2, 1] = flown
        step = problem.parameter_step(np.zeros(2), np.full((1, 4), 3.0), slopes, 0.0)
        np.testing.assert_allclose(step, [3.0, 0.0], rtol=1e-9)


@pytest.mark.filterwarnings("ignore:.*overflow.*:RuntimeWarning")
@pytest.mark.parametrize("flown", [1e80, 1e154, 1e200])
def test_a_window_whose_slopes_overflow_says_nothing_of_parameters(
    flown: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So far that their squares, or sums and products of these, are no numbers."""
    shooter: Any = SimpleNamespace(data=np.array([4, 4]), count=8, recording=np.zeros(2, int))
    unknowns = [Unknown("a", 0.0, -10.0, 10.0, 1e-3)]
    problem = Problem(shooter, lambda _: Variant(None), unknowns, Hints(), None)  # type: ignore[arg-type]
    monkeypatch.setattr(problem, "projected", lambda residual, slopes, free: (residual, slopes))
    here: Any = SimpleNamespace(
        values=np.zeros(1), xi=np.zeros((2, 1)), residual=np.ones((2, 4)), cost=np.ones(2)
    )
    slopes = np.ones((2, 4, 1))
    slopes[1, 2] = flown
    found = problem._result(here, np.zeros((2, 4, 1)), slopes)
    np.testing.assert_array_equal(found.information[:, 0, 0], [4.0, 0.0])
    assert np.isfinite(found.covariance).all()
    low, high = confidence(found, ["a"])["a"]
    assert np.isfinite([low, high]).all()


def test_starts_may_be_readings_of_a_sensor_with_an_offset() -> None:
    """True positions 2 and 3, read at half their size and 0.1 more."""
    model = SimpleNamespace(nv=1)
    measurement = Measurement(1.0, np.array([0.1, 0.0]), np.array([0.5, 0.5]), np.zeros(2))
    shooter: Any = SimpleNamespace(nv=1, absolute=np.array([[[1.0, 0.2]], [[1.5, 0.2]]]))
    scene: Any = SimpleNamespace(model=model)
    problem = Problem(shooter, lambda _: Variant(scene, measurement), [], Hints(), None)
    (found,) = problem._read(np.zeros(0), [np.array([[0.1, 0.0], [0.1, 0.0]])])
    np.testing.assert_allclose(shooter.absolute[:, 0] + found, [[2.0, 0.4], [3.0, 0.4]])
    plain = Problem(shooter, lambda _: Variant(scene), [], Hints(), None)
    assert plain._read(np.zeros(0), [np.zeros((2, 2))]) == []


def test_a_step_to_an_impossible_scene_is_shortened(arm: orbisim.Scene) -> None:
    """A payload's first step may ask for a negative inertia."""
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    runs = inject_effect(arm, friction, duration=3.0, episodes=2, noise=1e-4, seed=1)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    refused: list[float] = []

    def build(values: np.ndarray) -> Variant:
        torque = float(values[0])
        if not refused and abs(torque - 0.02) > 0.01:  # the first long step
            refused.append(torque)
            raise SceneError("arm.xml", "MuJoCo refuses it")
        return Hypothesis((friction.replace(torque=torque),)).variant(arm)

    start = Unknown("torque", 0.02, 0.0, 1.0, 1e-4)
    found = gauss_newton(bench.shooter(bench.fit), build, [start], iterations=8)
    assert len(refused) == 1
    assert found.values[0] == pytest.approx(0.1, rel=0.05)


def test_a_window_that_nothing_explains_does_not_widen_intervals(arm: orbisim.Scene) -> None:
    """A sensor that jumps in one window of a dozen."""
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    runs = inject_effect(arm, friction, duration=3.0, episodes=2, noise=1e-3, seed=1)
    noise, name = np.full(2, 1e-3), "qpos/elbow"
    broken = runs[0][name].copy()
    broken[20:40] += 1.0
    wrong = runs[0].replace(signals={**runs[0].signals, name: broken})

    def deviation(recordings: list[Recording]) -> float:
        bench = make_bench(arm, prepare_all(recordings, arm), 0.5).whole((noise, 10 * noise))
        found = Judge(bench, bench.intervals, heavy=True).judge(Hypothesis((friction,)))
        assert found is not None
        return float(np.sqrt(found.fit.covariance[0, 0]))

    assert deviation([wrong, runs[1]]) < 2 * deviation(runs)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_window_that_overflows_keeps_its_start(value: float) -> None:
    rng = np.random.default_rng(1)
    matrix, wanted = rng.normal(size=(3, 9, 4)), rng.normal(size=(3, 9))
    moves = least_squares(matrix, wanted, np.zeros(3))
    matrix[1, 2, 3] = value
    again = least_squares(matrix, wanted, np.zeros(3))
    np.testing.assert_array_equal(again[[0, 2]], moves[[0, 2]])
    assert not again[1].any()


def test_derivatives_are_taken_anew_where_a_step_was_not_foreseen() -> None:
    """Of four windows, the second does something else, the third misses by less than noise, and
    the fourth flies off."""
    shooter: Any = SimpleNamespace(data=np.full(4, 4))
    problem = Problem(shooter, lambda _: Variant(None), [], Hints(), None)  # type: ignore[arg-type]
    slopes, free = np.full((4, 4, 1), 2.0), np.ones((4, 4, 1))
    before: Any = SimpleNamespace(
        values=np.zeros(1), xi=np.zeros((4, 1)), residual=np.full((4, 4), 90.0)
    )
    foreseen = 90.0 - 2.0 * 30.0 - 10.0
    residual = foreseen + np.array([[0.0], [30.0], [0.09], [np.nan]]) * np.ones(4)
    after: Any = SimpleNamespace(
        values=np.full(1, 30.0), xi=np.full((4, 1), 10.0), residual=residual
    )
    np.testing.assert_array_equal(
        problem._stale(before, after, slopes, free), [False, True, False, True]
    )


def test_derivatives_that_are_kept_lead_to_the_same_fit(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With derivatives taken anew in a fraction of the windows, or in all of them at each step."""
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    runs = inject_effect(arm, friction, duration=4.0, episodes=2, noise=1e-4, seed=1)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    shooter = bench.shooter(bench.fit)
    taken: list[float] = []
    plain = Problem.slopes

    def slopes(self: Problem, here: Any, only: Any = None) -> Any:
        if len(self.shooter) == len(shooter):  # not those within it of some windows
            taken.append(1.0 if only is None else float(np.mean(only)))
        return plain(self, here, only)

    monkeypatch.setattr(Problem, "slopes", slopes)

    def found(stale: float) -> tuple[float, float]:
        taken.clear()
        monkeypatch.setattr("orbisim.shooting.gauss_newton._STALE", stale)
        fit = gauss_newton(
            shooter,
            lambda values: Hypothesis((friction.replace(torque=float(values[0])),)).variant(arm),
            [Unknown("torque", 0.02, 0.0, 1.0, 1e-4)],
            iterations=8,
        )
        return float(fit.values[0]), sum(taken)

    (kept, few), (anew, many) = found(0.1), found(0.0)
    assert kept == pytest.approx(anew, rel=1e-3)
    assert 1.0 <= few < 0.7 * many
