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
from orbisim.shooting.halving import coarsest, difference, halving, matters
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


def test_windows_with_impacts_count_only_where_most_have_some() -> None:
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
    rugged = dataclasses.replace(bench, samples=every, contacts=True)
    assert rugged.rugged and halving(rugged) == halving(bench)


def test_the_error_of_a_step_matters_beside_what_is_left() -> None:
    bench = _bench(0.002)
    error = halving(bench)
    assert matters(bench, 1.0) and matters(bench, 7.9 * error) and not matters(bench, 8.1 * error)
    # where bodies touch, too, as it falls with the step
    assert matters(dataclasses.replace(bench, contacts=True), 1.0)


def test_where_bodies_touch_an_error_that_does_not_fall_with_the_step_does_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = _bench(0.002)
    touching = dataclasses.replace(bench, contacts=True)
    for share, falls in ((0.5, True), (0.55, True), (0.7, False), (1.0, False), (1.4, False)):

        def error(one: Bench, _: Hypothesis | None, share: float = share) -> float:
            return 3.0 if one is touching or one is bench else 3.0 * share

        monkeypatch.setattr(halving_module, "halving", error)
        assert matters(touching, 1.0) == falls
        assert matters(bench, 1.0)  # nothing touches
        assert not matters(touching, 100.0)


PUCK = """<mujoco><option timestep="0.005"/><worldbody>
<geom type="plane" size="5 5 1" friction="0.4"/>
<body pos="0 0 0.02"><freejoint name="free"/>
<geom type="cylinder" size="0.05 0.02" mass="0.3" friction="0.4"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("spins", "falls"),
    [((8.0, -9.0, 10.0), False), ((2.0, -2.0, 3.0), True)],
    ids=["spun fast", "spun slowly"],
)
def test_a_step_through_a_sliding_contact_matters_only_as_far_as_its_error_falls(
    spins: tuple[float, ...], falls: bool
) -> None:
    """Either error alone, twice as large as half the step changes, would."""
    scene, speeds = orbisim.load_scene(PUCK), (1.0, 1.5, 2.0)
    pose = [0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0]
    moves = zip(speeds, spins, strict=True)
    starts = [[*pose, speed, 0.2, 0.0, 0.0, 0.0, spin] for speed, spin in moves]
    runs = inject_effect(scene, [], starts=starts, duration=0.8, episodes=3, noise=1e-5, seed=3)
    bench = make_bench(scene, prepare_all(runs, scene), 0.2)
    assert bench.contacts and not bench.rugged
    here, finer = halving(bench), halving(stepped(bench, 0.0025))
    assert here > 1.0
    assert (finer < 0.55 * here) == falls
    assert matters(bench, 1.0) == falls
