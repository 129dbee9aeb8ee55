"""Fits of hypotheses, most of them where bodies touch: what is chained through impacts says little,
simulations say more.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.effects.contacts import restitution_of
from orbisim.errors import SceneError
from orbisim.host.deadline import TimeIsUpError
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.confidence import confidence
from orbisim.shooting.fits import Fit, Hints
from orbisim.shooting.gauss_newton import Problem
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, Judged, _by_window
from orbisim.shooting.retune import Tunable, retuned
from orbisim.shooting.shooter import Variant
from orbisim.shooting.timestep import stepped, taken
from orbisim.testing import inject_effect

HAMMER = """
<mujoco model="hammer">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="head" pos="0 0 0.1">
      <joint name="slide" type="slide" axis="0 0 1" damping="3"/>
      <geom name="head" type="sphere" size="0.05" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="slide" gear="10" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
GAIN = Tunable("gain", "lift")
DAMPING = Tunable("damping", "slide")
BIAS = EffectInstance("torque_bias", "lift", {"offset": 0.06})


@pytest.fixture(scope="module")
def hammer() -> orbisim.Scene:
    """A mass on a rail that a motor lifts and drops on the floor."""
    return orbisim.load_scene(HAMMER)


def struck(
    hammer: orbisim.Scene, true: orbisim.Scene, effects: list[EffectInstance], most: int = 24
) -> tuple[Bench, Judge, Judged]:
    """Recordings of a scene with effects, for the declared one; and what that leaves."""
    rng = np.random.default_rng(3)
    controls = np.repeat(rng.uniform(-0.2, 1.0, (3, 16, 1)), 25, axis=1)
    runs = inject_effect(
        true, effects, controls=controls, rate=100.0, episodes=3, noise=1e-4, seed=2
    )
    bench = make_bench(hammer, prepare_all(runs, hammer), 0.4)
    assert bench.contacts
    judge = Judge(bench, bench.intervals, most=most)
    nothing = judge.judge(Hypothesis())
    assert nothing is not None and nothing.ratio > 3
    return bench, judge, nothing


@pytest.fixture(scope="module")
def pushed(hammer: orbisim.Scene) -> tuple[Judge, Judged]:
    """Recordings with a bias, and what the declared scene leaves of them."""
    _, judge, nothing = struck(hammer, hammer, [BIAS])
    return judge, nothing


def test_declared_parameters_are_retuned_through_impacts(hammer: orbisim.Scene) -> None:
    true = retuned(hammer, {GAIN: 1.04, DAMPING: 0.97})
    _, judge, nothing = struck(hammer, true, [])
    tuned = judge.judge(Hypothesis().tuned([GAIN, DAMPING]), begin=judge.begin(nothing))
    assert tuned is not None and tuned.ratio < 1.3
    factors = dict(tuned.hypothesis.factors)
    assert factors[GAIN] == pytest.approx(1.04, abs=0.01)
    assert factors[DAMPING] == pytest.approx(0.97, abs=0.02)


def test_a_glance_tells_how_large_an_effect_should_be(pushed: tuple[Judge, Judged]) -> None:
    judge, nothing = pushed
    begin = judge.begin(nothing)
    right = Hypothesis((BIAS,))
    for offset in (0.03, 0.12):
        other = Hypothesis((BIAS.replace(offset=offset),))
        left, better = judge.sized_glance(other, begin)
        assert better == pytest.approx(0.06 / offset, rel=0.35)
        assert left < nothing.ratio**2
    assert judge.sized_glance(right, begin)[1] == pytest.approx(1.0, abs=0.15)
    wrong = Hypothesis((BIAS.replace(offset=-0.06),))
    assert judge.glance(right, begin) < judge.glance(wrong, begin)


def test_a_glance_at_an_event_is_not_ruled_by_one_window(pushed: tuple[Judge, Judged]) -> None:
    """Over every window it is a mean of logarithms, which is less than the logarithm of a mean."""
    judge, nothing = pushed
    begin = judge.begin(nothing)
    wrong = Hypothesis((BIAS.replace(offset=-0.6),))
    event, mean = judge.glance(wrong, begin, every=True), judge.glance(wrong, begin)
    assert 1 < event < np.log1p(mean) < mean < np.inf


def test_a_glance_lets_retuned_parameters_move(hammer: orbisim.Scene) -> None:
    """Seen from parameters that made up for an effect, its true size leaves nothing."""
    _, judge, nothing = struck(hammer, retuned(hammer, {GAIN: 1.03}), [BIAS])
    tuned = judge.judge(Hypothesis().tuned([GAIN, DAMPING]), begin=judge.begin(nothing))
    assert tuned is not None and tuned.ratio > 1.5
    begin = judge.begin(tuned)
    with_it = dataclasses.replace(tuned.hypothesis, effects=(BIAS,))
    without = judge.glance(tuned.hypothesis, begin)
    assert judge.glance(with_it, begin) < 0.3 * without
    assert judge.tried(with_it, begin) < 0.3 * without


def test_without_a_start_a_glance_says_nothing(pushed: tuple[Judge, Judged]) -> None:
    judge, _ = pushed
    assert judge.sized_glance(Hypothesis(), judge.cold) == (np.inf, 1.0)


def test_a_glance_does_without_derivatives_that_cannot_be_had(
    pushed: tuple[Judge, Judged], monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, nothing = pushed

    def refuse(*_: Any) -> None:
        raise SceneError("hammer.xml", "MuJoCo refuses it")

    monkeypatch.setattr("orbisim.shooting.judge.own_slopes", refuse)
    begin = dataclasses.replace(judge.begin(nothing))
    left, better = judge.sized_glance(Hypothesis((BIAS,)), begin)
    assert left < nothing.ratio**2 and better == 1.0


def test_a_late_sensor_is_predicted_to_within_the_noise(arm: orbisim.Scene) -> None:
    late = EffectInstance("sensor_delay", "shoulder", {"delay": 0.08})
    runs = inject_effect(arm, [late], duration=4.0, episodes=3, noise=2e-4, seed=3)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    judge = Judge(bench, bench.intervals)
    held = Hypothesis((late,), frozen=frozenset({(0, "delay")}))
    judged, declared = judge.judge(held), judge.judge(Hypothesis())
    assert judged is not None
    assert declared is not None
    assert judged.ratio < 1.1
    assert declared.ratio > 5
    found = judge.judge(Hypothesis((late.replace(delay=0.03),)))
    assert found is not None
    assert found.hypothesis.effects[0].values["delay"] == pytest.approx(0.08, rel=0.01)


def test_what_is_searched_on_a_grid_is_as_sure_as_the_cost_rises_beside_it(
    arm: orbisim.Scene,
) -> None:
    """A gate's width has no derivative; its interval is that of its profile, and those of other
    numbers are the bootstrap's still."""
    gate = EffectInstance("deadband", "elbow", {"width": 0.5}, {"kind": "gate"})
    damping = EffectInstance("viscous_damping", "shoulder", {"coefficient": 0.05})
    runs = inject_effect(arm, [gate, damping], duration=4.0, episodes=3, noise=2e-4, seed=5)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    begin = gate.replace(width=0.42), damping.replace(coefficient=0.03)
    found = Judge(bench, bench.intervals).judge(Hypothesis(begin))
    assert found is not None and found.ratio < 1.3
    wide, narrow = confidence(found.fit, ["width", "coefficient"]).values()
    assert wide[0] < 0.5 < wide[1]
    assert 1e-4 < np.ptp(wide) < 0.1
    assert narrow[0] < 0.05 < narrow[1]
    flat = found.fit.values[1] - 1.96 * np.sqrt(found.fit.covariance[1, 1])
    assert narrow[0] <= flat


def test_starts_of_fitted_and_checked_windows_are_put_together(arm: orbisim.Scene) -> None:
    damping = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.05})
    runs = inject_effect(arm, damping, duration=3.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    search = Judge(bench, bench.intervals)
    apart = search.judge(Hypothesis())
    judge = Judge(bench.whole(), bench.intervals)
    assert apart is not None and judge.check is judge.fitted
    begin = judge.begin_joined(apart, search)
    together = judge.score(Hypothesis(), begin, 0)
    assert together.square == pytest.approx(apart.fit.square + apart.check_fit.square, rel=1e-9)


def test_windows_that_were_left_out_start_at_the_references(arm: orbisim.Scene) -> None:
    damping = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.05})
    runs = inject_effect(arm, damping, duration=3.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    search = Judge(bench, bench.intervals, most=3)
    few = search.judge(Hypothesis())
    judge = Judge(bench.whole(), bench.intervals)
    assert few is not None
    begin = judge.begin_joined(few, search)
    own = judge.fitted.windows.first
    known = np.isin(own, few.windows.first)
    assert known.sum() == 3 and begin.start is not None
    np.testing.assert_array_equal(begin.start[known], few.fit.start)
    checked = np.isin(own, search.check.windows.first)
    np.testing.assert_array_equal(begin.start[checked & ~known], few.check_fit.start)
    assert not begin.start[~known & ~checked].any()


def test_an_explanation_has_the_starts_of_others_too(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One step of a fit, and a whole one: what the latter has found is no merit of it."""
    damping = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.3})
    runs = inject_effect(arm, damping, duration=3.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    judge = Judge(bench.whole(), bench.intervals, heavy=True)
    good, poor = judge.judge(Hypothesis(), 8), judge.judge(Hypothesis(), 0)
    assert good is not None and poor is not None and good.loss < poor.loss - 0.05
    assert judge.fair(poor, [good]).loss < good.loss + 1e-3
    with monkeypatch.context() as patch:
        patch.setattr(judge, "_scored", lambda *_: poor.fit)  # nothing better is found
        assert judge.fair(poor, [good]) is poor
    some = Judge(bench, bench.intervals, heavy=True)
    apart = some.judge(Hypothesis(), 0)
    assert apart is not None and some.fair(apart, []) is apart


SOFT = {"coefficient": restitution_of(0.4), "stiffness": 1500.0}


@pytest.fixture(scope="module")
def softened(hammer: orbisim.Scene) -> tuple[Judge, Judged]:
    """Recordings of a softer head, and what the declared scene leaves of them."""
    soft = EffectInstance("restitution", "head", SOFT)
    _, judge, nothing = struck(hammer, hammer, [soft], most=8)
    return judge, nothing


def test_a_restart_finds_what_a_fit_through_impacts_missed(
    softened: tuple[Judge, Judged],
) -> None:
    """From a head four times as stiff, some windows' starts stay poor without one."""
    judge, nothing = softened
    hard = {"coefficient": restitution_of(1.0), "stiffness": 6000.0}
    far = EffectInstance("restitution", "head", hard)
    plain, restarted = (
        judge.judge(Hypothesis((far,)), begin=judge.begin(nothing), restarts=restarts)
        for restarts in (0, 3)
    )
    assert plain is not None and restarted is not None
    assert restarted.fit.square < 0.9 * plain.fit.square
    # to what its step leaves unknown of an impact, which is the same as the truth's here
    assert restarted.hypothesis.effects[0].values == pytest.approx(SOFT, rel=0.03)
    off = [
        abs(one.hypothesis.effects[0].values["coefficient"] - SOFT["coefficient"])
        for one in (plain, restarted)
    ]
    assert off[1] < 0.5 * off[0]


PUCK = """
<mujoco model="puck">
  <option timestep="0.002"/>
  <worldbody>
    <geom name="table" type="plane" size="4 4 0.1" friction="0.25"/>
    <body name="puck" pos="0 0 0.03">
      <freejoint name="puck"/>
      <geom name="puck" type="cylinder" size="0.045 0.012" mass="0.17" friction="0.25"/>
    </body>
  </worldbody>
</mujoco>
"""


def thrown(model: mujoco.MjModel, seed: int) -> orbisim.Recording:
    """A puck that is thrown, tumbles, slides and comes to rest, seen at 125 Hz."""
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(seed), []
    data.qvel[:2], data.qvel[3:] = rng.uniform(-1.5, 1.5, 2), rng.uniform(-3, 3, 3)
    for step in range(300):
        if step % 4 == 0:
            place = data.qpos[:3] + 2e-4 * rng.normal(size=3)
            turn = data.qpos[3:] + 1e-3 * rng.normal(size=4)
            rows.append(np.hstack([data.time, place, turn / np.linalg.norm(turn)]))
        mujoco.mj_step(model, data)
    seen = np.array(rows)
    return orbisim.Recording(seen[:, 0], {"qpos/puck": seen[:, 1:]}, source=f"throw{seed}")


def test_a_restart_takes_the_friction_of_what_slides_as_far_as_starts_of_its_own_say() -> None:
    """Along a motion that ends too late, no start of a window is right for a greater friction."""
    true = 0.267
    model = orbisim.load_scene(PUCK.replace('"0.25"', f'"{true}"')).model
    scene = orbisim.load_scene(PUCK)
    runs = prepare_all([thrown(model, seed) for seed in range(6)], scene)
    bench = make_bench(scene, runs, 0.5)
    judge = Judge(bench, bench.intervals)
    nothing = judge.judge(Hypothesis())
    assert nothing is not None
    near = EffectInstance("sliding_friction", "puck", {"coefficient": 0.26})
    found = judge.judge(Hypothesis((near,)), begin=judge.begin(nothing), restarts=1)
    assert found is not None
    assert found.hypothesis.effects[0].values["coefficient"] == pytest.approx(true, abs=0.002)


def test_through_impacts_too_an_explanation_has_the_starts_of_others(
    softened: tuple[Judge, Judged],
) -> None:
    """What one of them has found is no merit of it, nor in windows that are only checked."""
    judge, nothing = softened
    assert judge.check is not judge.fitted
    good = judge.judge(Hypothesis((EffectInstance("restitution", "head", SOFT),)), restarts=1)
    assert good is not None
    other = {"coefficient": restitution_of(0.5), "stiffness": 1500.0}
    hypothesis = Hypothesis((EffectInstance("restitution", "head", other),))
    poor = judge.judge(hypothesis, 0, begin=judge.begin(nothing))
    assert poor is not None
    same = judge.started(poor, [nothing, good])
    assert same.hypothesis.effects[0].effect == "restitution"
    assert same.loss < poor.loss - 0.01 and same.fit.square < poor.fit.square
    assert judge.started(good, [good]) is good  # nobody has other starts


def _softness(softened: tuple[Judge, Judged]) -> tuple[Judge, Judged]:
    """What judges, and the bouncing head as it is, fitted."""
    judge, _ = softened
    found = judge.judge(Hypothesis((EffectInstance("restitution", "head", SOFT),)))
    assert found is not None
    return judge, found


def test_no_number_is_surer_than_its_cost_rises_beside_it(
    softened: tuple[Judge, Judged], monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, found = _softness(softened)
    monkeypatch.setattr(Judge, "_as_sure_as_steps", lambda *_: iter(()))
    known = np.diag(found.fit.covariance)
    narrow = dataclasses.replace(found.fit, covariance=1e-8 * found.fit.covariance)
    wider = judge.as_sure(dataclasses.replace(found, fit=narrow))
    assert wider.hypothesis is found.hypothesis
    deviation = np.sqrt(np.diag(wider.fit.covariance) / known)
    assert np.all((deviation > 0.2) & (deviation < 5)), deviation
    wide = dataclasses.replace(found, fit=dataclasses.replace(narrow, covariance=np.eye(2) * 1e12))
    assert judge.as_sure(wide) is wide


def test_what_leaves_less_beside_a_fit_is_taken(softened: tuple[Judge, Judged]) -> None:
    """How sure a number is cannot be asked of a fit that another place leaves behind."""
    judge, nothing = softened
    hard = {"coefficient": restitution_of(1.0), "stiffness": 6000.0}
    far = Hypothesis((EffectInstance("restitution", "head", hard),))
    poor = judge.judge(far, begin=judge.begin(nothing))
    assert poor is not None
    sure = judge.as_sure(poor)
    assert sure.loss < poor.loss and sure.fit.square < 0.99 * poor.fit.square
    assert sure.hypothesis.effects[0].values == pytest.approx(SOFT, rel=0.1)
    assert sure.hypothesis.frozen == poor.hypothesis.frozen


def test_no_number_is_surer_than_it_stays_in_half_of_the_step(
    softened: tuple[Judge, Judged], monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, found = _softness(softened)
    narrow = dataclasses.replace(
        found, fit=dataclasses.replace(found.fit, covariance=1e-12 * found.fit.covariance)
    )
    monkeypatch.setattr(Judge, "_as_sure_as_costs", lambda *_: iter(()))
    wider = judge.as_sure(narrow)
    finer = stepped(judge.bench, taken(judge.bench) / 2)
    other = Judge(finer, finer.intervals, most=judge.most)
    there = other.judge(found.hypothesis, 3, polish=False, begin=judge.begin(found))
    assert there is not None
    moved = np.abs(there.fit.values - found.fit.values)
    np.testing.assert_allclose(np.sqrt(np.diag(wider.fit.covariance)), moved, rtol=0.05)


def test_numbers_are_as_sure_as_is_known_when_the_time_is_up(
    softened: tuple[Judge, Judged], monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, found = _softness(softened)

    def late(_: Judge, judged: Judged) -> Iterator[Fit]:
        yield dataclasses.replace(judged.fit, covariance=7.0 * judged.fit.covariance)
        raise TimeIsUpError

    monkeypatch.setattr(Judge, "_as_sure_as_steps", late)
    monkeypatch.setattr(Judge, "_as_sure_as_costs", late)
    known = found.fit.covariance
    np.testing.assert_allclose(judge.as_sure(found).fit.covariance, 49.0 * known)


def test_where_nothing_touches_numbers_are_as_sure_as_the_fit_says(arm: orbisim.Scene) -> None:
    damping = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.3})
    runs = inject_effect(arm, damping, duration=2.0, episodes=1, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    judge = Judge(bench.whole(), bench.intervals)
    found = judge.judge(Hypothesis((damping,)))
    assert found is not None and not bench.contacts
    assert judge.as_sure(found) is found


def test_starts_alone_are_the_better_of_two_in_each_window(
    softened: tuple[Judge, Judged],
) -> None:
    judge, nothing = softened
    right = Hypothesis((EffectInstance("restitution", "head", SOFT),))
    one = judge.score(right, judge.begin(nothing), 1)
    other = judge.score(right, judge.cold, 1)
    both = _by_window(one, other)
    np.testing.assert_allclose(both.per_window, np.minimum(one.per_window, other.per_window))
    assert both.square == pytest.approx(both.per_window.sum())
    assert both.square < min(one.square, other.square)  # neither is the better in all
    for w in range(len(both.per_window)):
        of = one if one.per_window[w] <= other.per_window[w] else other
        np.testing.assert_array_equal(both.start[w], of.start[w])


def _problem(judge: Judge, hypothesis: Hypothesis) -> Problem:
    """As a fit has it."""
    scene, hints = judge.bench.scene, Hints()
    unknowns = hypothesis.unknowns(scene)
    return Problem(
        judge.fitted, lambda x: hypothesis.at(scene, x).variant(scene), unknowns, hints, None
    )


def test_slopes_where_impacts_scatter_are_taken_over_a_tenth(
    softened: tuple[Judge, Judged], pushed: tuple[Judge, Judged]
) -> None:
    """At least, and over no more than a number may be: over less, they are those of details."""
    soft = EffectInstance("restitution", "head", SOFT)
    for (judge, nothing), effect in ((softened, soft), (pushed, BIAS)):
        problem = _problem(judge, Hypothesis((effect,)))
        assert judge.fitted.whitening is not None
        for p, unknown in enumerate(problem.unknowns):
            assert unknown.step < 0.01 * unknown.start  # where nothing scatters
            assert unknown.widest is not None
            wide = min(0.1 * unknown.start, unknown.widest)
            assert problem._width(p, unknown.start) == pytest.approx(wide)
            assert problem._width(p, 0.0) == unknown.step
        begun = problem.trial(problem.begin, nothing.fit.start)
        slopes, base = problem.slopes(begun), judge.fitted.scaled(begun.simulated)
        for p, unknown in enumerate(problem.unknowns):
            least, most = 0.1 * unknown.start, max(unknown.widest or 0.0, 0.1 * unknown.start)
            number = np.arange(len(problem.unknowns)) == p
            width = problem._width(p, unknown.start)
            steps = {p: unknown.step_from(unknown.start, width)}
            changes = problem._changes(begun, steps)
            problem._widen(begun, steps, changes)
            assert least * 0.999 <= width <= abs(steps[p]) <= most * 1.001
            moved = problem.trial(problem.begin + steps[p] * number, begun.xi)
            change = judge.fitted.scaled(moved.simulated) - base
            np.testing.assert_allclose(slopes[..., p], change / steps[p], rtol=1e-6, atol=1e-6)


def test_a_difference_is_no_wider_than_scenes_are_possible(
    softened: tuple[Judge, Judged],
) -> None:
    """To the other side, where one leads to none; as narrow as it was, where both do."""
    judge, nothing = softened
    problem = _problem(judge, Hypothesis((EffectInstance("restitution", "head", SOFT),)))
    begun, build = problem.trial(problem.begin, nothing.fit.start), problem.build
    refused: list[float] = []

    def only(low: float, high: float) -> None:
        def some(values: npt.NDArray[np.float64]) -> Variant:
            if not low <= values[0] <= high:
                refused.append(float(values[0]))
                raise SceneError("hammer.xml", "no such scene")
            return build(values)

        problem.build = some

    at = float(problem.begin[0])
    only(0.0, at)
    assert problem._step_by(begun, 0, 0.1) == -0.1
    only(at - 1e-3, at + 1e-3)
    assert problem._step_by(begun, 0, 0.1) is None
    assert problem._step_by(begun, 0, 1e-4) == 1e-4
    narrow = problem.slopes(begun)
    assert np.isfinite(narrow).all() and narrow[..., 0].any() and refused


def test_slopes_where_nothing_touches_are_taken_over_little(arm: orbisim.Scene) -> None:
    damping = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.3})
    runs = inject_effect(arm, damping, duration=2.0, episodes=1, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    judge = Judge(bench.whole(), bench.intervals)
    problem = _problem(judge, Hypothesis((damping,)))
    problem.slopes(problem.trial(problem.begin, np.zeros((len(judge.fitted), 4))))
    (unknown,) = problem.unknowns
    assert problem._width(0, unknown.start) == unknown.step < 0.01 * unknown.start
