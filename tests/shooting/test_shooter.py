"""Windows that are simulated: of late sensors, from moved starts, and some of them."""

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.effects.carry import hooks_of
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.gauss_newton import start_derivatives
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.shooter import Variant
from orbisim.testing import inject_effect

LATE = EffectInstance("sensor_delay", "shoulder", {"delay": 0.08})


@pytest.fixture(scope="module")
def bench(arm: orbisim.Scene) -> Bench:
    """Recordings in which one joint is read late."""
    runs = inject_effect(arm, [LATE], duration=3.0, episodes=2, noise=2e-4, seed=3)
    return make_bench(arm, prepare_all(runs, arm), 0.5)


def test_a_sensor_that_is_hardly_late_is_read_as_one_that_is_not(bench: Bench) -> None:
    """Whatever else is missing: a delay of nothing is nothing."""
    shooter = bench.shooter(bench.fit)
    late = Hypothesis((LATE.replace(delay=1e-9),)).variant(bench.scene)
    start = np.random.default_rng(0).normal(0, 1e-2, (len(shooter), 2 * shooter.nv))
    np.testing.assert_allclose(
        shooter.simulate(late, start), shooter.simulate(Variant(bench.scene), start), atol=1e-6
    )
    for late_states, states in zip(
        shooter.states(late, start), shooter.states(Variant(bench.scene), start), strict=True
    ):
        np.testing.assert_array_equal(late_states, states)


@pytest.mark.parametrize("delay", [0.04, 0.12, -0.04, -0.12])
def test_what_a_late_sensor_read_before_a_window_is_no_reason_for_or_against_it(
    bench: Bench, delay: float
) -> None:
    """Nothing says what that was: the mean square is that of the samples of which something is
    known, for early sensors, which read what comes after a window, as for late ones."""
    shooter = bench.shooter(bench.fit)
    variant = Hypothesis((LATE.replace(delay=delay),)).variant(bench.scene)
    start = np.random.default_rng(0).normal(0, 1e-3, (len(shooter), 2 * shooter.nv))
    residual = shooter.residual(shooter.simulate(variant, start))
    own = residual.reshape(len(shooter), shooter.windows.length + 1, -1)[..., 0]
    step = shooter.time[0, 1] - shooter.time[0, 0]
    unknown = round(abs(delay) / step)
    outside = np.arange(own.shape[1]) < unknown
    outside = outside[::-1] if delay < 0 else outside
    np.testing.assert_allclose(own[:, outside], 0.0, atol=1e-9)
    read = variant.measurement.of(
        shooter.absolute, shooter.simulate(Variant(bench.scene), start), shooter.time
    )
    plain = shooter.residual(read).reshape(*own.shape, -1)[..., 0][:, ~outside]
    np.testing.assert_allclose((own**2).mean(axis=1), (plain**2).mean(axis=1), rtol=1e-9)


@pytest.mark.parametrize(("delay", "extrapolated"), [(0.3, False), (0.45, True)])
def test_a_few_readings_do_not_stand_for_a_whole_window(
    bench: Bench, delay: float, extrapolated: bool
) -> None:
    """Of windows of 0.5 s, the last 0.05 s: what is before is then extrapolated."""
    shooter = bench.shooter(bench.fit)
    start = np.zeros((len(shooter), 2 * shooter.nv))
    variant = Hypothesis((LATE.replace(delay=delay),)).variant(bench.scene)
    free, early = shooter.simulate(Variant(bench.scene), start), shooter.staggered(variant)
    read = variant.measurement.of(shooter.absolute, free, shooter.time, early)
    assert early > 0
    assert np.array_equal(shooter.simulate(variant, start), read) == extrapolated


@pytest.mark.parametrize("delay", [0.037, -0.037, 0.3, 0.45])
def test_what_starts_do_to_a_late_sensor_follows_from_what_they_do_to_the_motion(
    bench: Bench, delay: float
) -> None:
    shooter = bench.shooter(bench.fit)
    variant = Hypothesis((LATE.replace(delay=delay),)).variant(bench.scene)
    start = np.zeros((len(shooter), 2 * shooter.nv))
    free = shooter.chained(bench.intervals)
    assert shooter.read_late(free, Variant(bench.scene).measurement) is free
    shown = start_derivatives(shooter, variant, start)
    found = shooter.read_late(free, variant.measurement)
    plainly = np.linalg.norm(start_derivatives(shooter, Variant(bench.scene), start) - free)
    assert np.linalg.norm(found - shown) < 2 * plainly + 0.02 * np.linalg.norm(shown)
    assert np.linalg.norm(free - shown) > 2 * np.linalg.norm(found - shown)


def test_starts_that_are_moved_together_are_moved_one_by_one(bench: Bench) -> None:
    shooter, variant = bench.shooter(bench.fit), Variant(bench.scene)
    start = np.random.default_rng(0).normal(0, 1e-3, (len(shooter), 2 * shooter.nv))
    which = np.array([2, 0])
    steps = 1e-3 * np.arange(1.0, start.shape[1] + 1)  # each number by its own
    every = shooter.moved(variant, start, steps, which)
    for column, runs in enumerate(every):
        moved = start.copy()
        moved[:, column] += steps[column]
        np.testing.assert_array_equal(runs, shooter.simulate(variant, moved)[which])
    assert shooter.moved(variant, start, steps, np.array([], int)).shape[1] == 0


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
    last = len(shooter) - 1  # in the other recording
    np.testing.assert_array_equal(shooter.some(np.array([last, 0])).recording, [1, 0])


def _variants(bench: Bench, *every: tuple[EffectInstance, ...]) -> list[Variant]:
    return [Hypothesis(effects).variant(bench.scene) for effects in every]


def test_scenes_that_differ_in_hooks_or_sensors_are_simulated_at_once_as_one_by_one(
    bench: Bench,
) -> None:
    shooter = bench.shooter(bench.fit)
    start = np.random.default_rng(0).normal(0, 1e-3, (len(shooter), 2 * shooter.nv))
    bias, slow = (EffectInstance("sensor_bias", "elbow", {"offset": x}) for x in (0.01, 0.02))
    damped = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.1})
    rough = EffectInstance("stribeck_friction", "elbow", {"coulomb": 0.1, "static": 0.2,
                                                          "velocity": 0.05})  # fmt: skip
    drags = [EffectInstance("linear_drag", "forearm", {"coefficient": x}) for x in (0.1, 0.2)]
    every = _variants(
        bench, (bias,), (rough,), (slow,), (damped,), (rough.replace(static=0.3),),
        (rough, damped), (drags[0], rough), (drags[1], rough.replace(velocity=0.02)), (LATE,), (),
    )  # fmt: skip
    hooks = [hooks_of(one.scene.model) for one in every]
    assert shooter._alike(every, hooks) == [[0, 2, 8], [1, 4], [3], [5], [6, 7], [9]]
    several = _variants(bench, (rough,), (rough.replace(static=0.3),), (rough.replace(coulomb=0),))
    drawn = _variants(bench, (drags[0], rough), (drags[1], rough.replace(velocity=0.02)))
    for some in (every, several, drawn, every[:1] + every[2:3], []):
        found = shooter.simulate_each(some, start)
        for one, runs in zip(some, found, strict=True):
            np.testing.assert_array_equal(runs, shooter.simulate(one, start))


def test_times_that_are_rounded_are_even_and_others_are_not(bench: Bench) -> None:
    shooter = bench.shooter(bench.fit)
    start, variant = np.zeros((len(shooter), 2 * shooter.nv)), Variant(bench.scene)
    count, last = shooter.windows.length, np.full(len(shooter), shooter.windows.length)
    assert list(shooter._spans(last, one_by_one=False)) == [(0, count)]
    assert len(list(shooter._spans(last, one_by_one=True))) == count
    exact = shooter.simulate(variant, start)
    step = shooter.time[0, 1] - shooter.time[0, 0]
    rng = np.random.default_rng(0)
    shooter.time = shooter.time + rng.uniform(-3e-5, 3e-5, shooter.time.shape) * step
    assert list(shooter._spans(last, one_by_one=False)) == [(0, count)]
    np.testing.assert_allclose(shooter.simulate(variant, start), exact, atol=1e-4)
    shooter.time = shooter.time + rng.uniform(-1e-2, 1e-2, shooter.time.shape) * step
    spans = list(shooter._spans(last, one_by_one=False))
    assert len(spans) > count / 4 and sum(n for _, n in spans) == count


def test_no_span_goes_beyond_a_window(bench: Bench) -> None:
    shooter = bench.shooter(bench.fit)
    last = np.full(len(shooter), shooter.windows.length)
    last[:2] = 3, 7
    spans = list(shooter._spans(last, one_by_one=False))
    assert spans == [(0, 3), (3, 4), (7, shooter.windows.length - 7)]


TURNING = """
<mujoco>
  <worldbody>
    <body><joint type="slide"/><geom size="0.1"/>
      <body><joint type="ball"/><geom size="0.1" pos="0.1 0 0"/></body>
    </body>
    <body><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def test_differences_are_those_of_mujoco() -> None:
    scene = orbisim.load_scene(TURNING)
    model, rng = scene.model, np.random.default_rng(1)
    runs = inject_effect(scene, [], duration=1.0, episodes=1, noise=1e-4, seed=1)
    bench = make_bench(scene, prepare_all(runs, scene), 0.3)
    shooter = bench.shooter(bench.fit)
    before, after = rng.normal(size=(2, 40, model.nq))
    for positions in (before, after):
        for turn in (slice(1, 5), slice(8, 12)):
            positions[:, turn] /= np.linalg.norm(positions[:, turn], axis=1)[:, None]
    after[0] = before[0]
    after[1, 1:5] = -before[1, 1:5]  # the same turn
    expected = np.zeros((40, model.nv))
    for row, one, other in zip(expected, before, after, strict=True):
        mujoco.mj_differentiatePos(model, row, 1.0, one, other)
    np.testing.assert_allclose(shooter.difference(before, after), expected, atol=1e-12)
