"""The error of a step is as large as what half of it changes, and falls with it."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.halving import coarsest, difference, halving
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.timestep import Stepping, stepped, stepping, with_stepping
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
