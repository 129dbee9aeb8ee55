"""The error of a step is as large as what half of it changes, and falls with it."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.shooting import halving as halving_module
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.halving import MATTERS, coarsest, difference, halving, matters
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.stepping import Stepping, stepping, with_stepping
from orbisim.shooting.timestep import stepped
from orbisim.testing import inject_effect

RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)

PENDULUM = """<mujoco><option timestep="{step}"/><worldbody>
<body><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


def _bench(step: float) -> Bench:
    truth, scene = (orbisim.load_scene(PENDULUM.format(step=one)) for one in (0.001, step))
    runs = inject_effect(truth, [], duration=3.0, episodes=2, noise=1e-4, seed=3)
    return make_bench(scene, prepare_all(runs, scene), 0.5)


def test_half_the_step_changes_half_as_much() -> None:
    coarse, fine = halving(_bench(0.002)), halving(_bench(0.001))
    assert coarse > 1.0
    assert fine == pytest.approx(coarse / 2, rel=0.02)


def test_dry_friction_needs_shorter_steps_than_the_scene() -> None:
    """Over a long one, a joint that comes to rest is not stopped where it stops."""
    bench = _bench(0.002)
    exact = dataclasses.replace(
        bench, scene=with_stepping(bench.scene, Stepping(0.002, RK4, dry=True))
    )
    friction = EffectInstance("coulomb_friction", "hinge", {"torque": 0.05})
    alone, beside = halving(exact), halving(exact, Hypothesis((friction,)))
    assert alone < 0.1 and beside > 1.0


def test_the_fewest_steps_are_those_that_change_no_more_than_they_may() -> None:
    bench = _bench(0.001)  # ten a sample
    at_two, at_four = (difference(bench, stepped(bench, 0.01 / count)) for count in (2, 4))
    assert at_two > at_four > 0
    found = coarsest(bench, 1.01 * at_four)
    assert stepping(found.scene).timestep == pytest.approx(0.0025)
    most = coarsest(bench, 100 * at_two)
    assert stepping(most.scene).timestep == pytest.approx(0.01)
    assert coarsest(bench, 0.9 * at_four) is bench  # eight would save a fifth
    touching = dataclasses.replace(bench, contacts=True)
    assert coarsest(touching, 100 * at_two) is touching


def test_windows_without_impacts() -> None:
    bench = _bench(0.002)
    jumping = [np.zeros_like(one.jumps) for one in bench.samples]
    jumping[0][:] = True  # all of one recording of two
    samples = tuple(
        dataclasses.replace(one, jumps=jumps)
        for one, jumps in zip(bench.samples, jumping, strict=True)
    )
    touching = dataclasses.replace(bench, samples=samples, contacts=True)
    other = bench.windows.recording == 1
    assert np.array_equal(touching.smooth, other) and not touching.rugged
    assert dataclasses.replace(touching, contacts=False).smooth.all()  # nothing touches
    every = tuple(dataclasses.replace(one, jumps=np.ones_like(one.jumps)) for one in bench.samples)
    assert dataclasses.replace(bench, samples=every, contacts=True).rugged


def test_a_difference_counts_beside_what_impacts_leave_unknown() -> None:
    bench = _bench(0.002)
    scatter = np.full((len(bench.windows), bench.windows.length + 1, 2), 3.0)
    unsure, sure = (
        dataclasses.replace(bench, windows=dataclasses.replace(bench.windows, scatter=one))
        for one in (scatter, 0.0 * scatter)
    )
    assert halving(unsure) < halving(bench) / 2
    assert halving(sure) == pytest.approx(halving(bench))


def test_the_error_of_a_step_matters_beside_what_is_left() -> None:
    bench = _bench(0.002)
    error = halving(bench)
    assert matters(bench, 1.0) and matters(bench, 7.9 * error) and not matters(bench, 8.1 * error)
    # where bodies touch, too, as it falls with the step
    assert matters(dataclasses.replace(bench, contacts=True), 1.0)


def test_where_bodies_touch_an_error_that_does_not_go_on_does_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = _bench(0.002)
    touching = dataclasses.replace(bench, contacts=True)
    rng = np.random.default_rng(0)
    first, beside = rng.standard_normal((2, 5, 100))
    for share, across, goes_on in (
        (0.5, 0, True), (0.5, 0.8, True), (0.1, 0.5, False), (0, 0.5, False), (-1, 0, False),
    ):  # fmt: skip

        def change(
            one: Bench,
            _: Bench,
            __: Hypothesis | None,
            share: float = share,
            across: float = across,
        ) -> np.ndarray:
            return 3.0 * (first if one in (touching, bench) else share * first + across * beside)

        monkeypatch.setattr(halving_module, "_change", change)
        assert matters(touching, 1.0) == goes_on
        assert matters(bench, 1.0)  # nothing touches
        assert not matters(touching, 100.0)


PUCK = """<mujoco><option timestep="0.005"/><worldbody>
<geom type="plane" size="5 5 1" friction="0.4"/>
<body pos="0 0 0.02"><freejoint name="free"/>
<geom type="cylinder" size="0.05 0.02" mass="0.3" friction="0.4"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("spins", "goes_on"),
    [((8.0, -9.0, 10.0), False), ((2.0, -2.0, 3.0), True)],
    ids=["spun fast", "spun slowly"],
)
def test_a_step_through_a_sliding_contact_matters_only_where_its_error_goes_on(
    spins: tuple[float, ...], goes_on: bool
) -> None:
    """Either error alone, twice as large as half the step changes, would."""
    scene, speeds = orbisim.load_scene(PUCK), (1.0, 1.5, 2.0)
    pose = [0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0]
    moves = zip(speeds, spins, strict=True)
    starts = [[*pose, speed, 0.2, 0.0, 0.0, 0.0, spin] for speed, spin in moves]
    runs = inject_effect(scene, [], starts=starts, duration=0.8, episodes=3, noise=1e-5, seed=3)
    bench = make_bench(scene, prepare_all(runs, scene), 0.2)
    assert bench.contacts and not bench.rugged
    assert 2.0 * halving(bench) > MATTERS
    assert matters(bench, 1.0) == goes_on
