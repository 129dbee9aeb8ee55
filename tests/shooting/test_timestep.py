"""The timestep of a scene, as recordings take it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.timestep import (
    Stepping,
    exact,
    held,
    is_exact,
    peak,
    stepping,
    taken,
    typical_interval,
    with_stepping,
    within_samples,
)
from orbisim.testing import inject_effect


@pytest.mark.parametrize(
    ("gains", "place"),
    [
        ({0.0: 0.0, 0.05: 0.19, 0.5: 1.0}, 0.5),  # of 4 s (1 - s): where it is known
        ({0.0: 0.0, 0.05: 3.5, 0.5: -10.0}, 0.2),  # of 80 s - 200 s²
        ({0.0: 0.0, 0.05: 2.45, 0.5: 20.0}, 1.0),  # of 50 s - 20 s²: no further than an interval
        ({0.0: 0.0, 0.05: -np.inf, 0.5: 1.0}, None),
        ({0.0: 0.0, 0.05: 1.0, 0.5: 20.0}, None),  # the steeper the further: no peak
    ],
)
def test_the_next_share_is_a_parabolas_peak(gains: dict[float, float], place: float | None) -> None:
    found = peak(gains, 0.0, 1.0)
    assert found == (None if place is None else pytest.approx(place, abs=0.02))


def test_a_sampling_interval_has_a_whole_number_of_steps(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], rate=100.0, duration=1.0, episodes=1, noise=1e-3, seed=0)
    bench = make_bench(arm, prepare_all(runs, arm), 0.3)
    assert typical_interval(bench) == pytest.approx(0.01)
    for asked, expected in ((0.002, 0.002), (0.003, 0.0025), (0.03, 0.01)):
        assert taken(bench, asked) == pytest.approx(expected)
    assert taken(bench) == pytest.approx(float(arm.model.opt.timestep))


def test_a_scene_takes_no_longer_steps_than_samples_are_apart(arm: orbisim.Scene) -> None:
    euler = int(mujoco.mjtIntegrator.mjINT_EULER)
    long, notes = with_stepping(arm, Stepping(0.02, euler)), list[str]()
    runs = inject_effect(arm, [], rate=100.0, duration=1.0, episodes=2, noise=1e-3, seed=0)
    short = within_samples(long, runs, notes)
    assert stepping(short) == Stepping(pytest.approx(0.01), euler)
    assert len(notes) == 1 and "0.01 s" in notes[0] and "0.02 s" in notes[0]
    # velocities of half a step before, by what a step is: those of the same scene with 10 ms
    ahead = [
        prepare_all(runs, one)[0].absolute for one in (short, with_stepping(arm, stepping(short)))
    ]
    assert np.array_equal(*ahead, equal_nan=True)
    near = with_stepping(arm, Stepping(0.0102, euler))  # a clock that jitters
    assert within_samples(near, runs, notes) is near and within_samples(arm, runs, notes) is arm
    assert len(notes) == 1


def test_the_scene_itself_keeps_its_timestep(arm: orbisim.Scene) -> None:
    before = float(arm.model.opt.timestep)
    finer = with_stepping(arm, Stepping(before / 4, arm.model.opt.integrator))
    assert finer.model.opt.timestep == pytest.approx(before / 4)
    assert arm.model.opt.timestep == before


def test_exact_steps_divide_the_sampling_interval(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], rate=100.0, duration=1.0, episodes=1, noise=1e-3, seed=0)
    euler = with_stepping(arm, Stepping(0.003, int(mujoco.mjtIntegrator.mjINT_EULER)))
    bench = make_bench(euler, prepare_all(runs, euler), 0.3)
    other = exact(bench, 4)
    assert is_exact(other) and not is_exact(bench)
    found = stepping(other.scene)
    assert found.integrator == int(mujoco.mjtIntegrator.mjINT_RK4)
    assert found.timestep == pytest.approx(0.0025)  # four make an interval of 10 ms
    assert held(bench, 0.001) is None
    own = held(other, 0.001)
    assert own is not None
    assert stepping(own.scene).integrator == int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    assert stepping(own.scene).timestep == pytest.approx(0.001)
    between = held(other, 0.0011)  # nine make an interval
    assert between is not None
    assert stepping(between.scene).timestep == pytest.approx(0.01 / 9)


CART = """<mujoco><option timestep="0.0002" gravity="0 0 0" integrator="implicitfast"/><worldbody>
<body><joint name="slide" type="slide" axis="1 0 0" frictionloss="2"{more}/>
<geom size=".05" mass="1"/></body></worldbody></mujoco>"""
FAST = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)


def test_friction_stops_what_it_stops_where_it_is_dry() -> None:
    """After v^2 / 2 a; with MuJoCo's default it creeps on for F / (2 m b^2), b = 2 / (0.95 tau)."""
    scene = orbisim.load_scene(CART.format(more=""))
    ways = []
    for dry in (False, True):
        other = with_stepping(scene, Stepping(0.0002, FAST, dry))
        assert stepping(other) == Stepping(0.0002, FAST, dry)
        engine = orbisim.make_backend("mujoco", other)
        state = engine.reset()
        state.qvel[:, 0] = 0.2
        way = float(engine.rollout(state, np.zeros((1500, 0))).qpos[0, -1, 0])
        ways.append(way - 0.2**2 / (2 * 2.0))
    step = 0.2 * 0.0002  # a step's way
    assert abs(ways[1]) < step
    assert ways[0] == pytest.approx(2.0 / (2 * (2 / (0.95 * 0.02)) ** 2), abs=step)


def test_dry_friction_is_as_short_as_another_step_is_and_soft_again() -> None:
    scene = orbisim.load_scene(CART.format(more=""))
    dry = with_stepping(scene, Stepping(0.001, FAST, dry=True))
    finer = with_stepping(dry, Stepping(0.0005, FAST, dry=True))
    assert dry.model.dof_solref[0, 0] == pytest.approx(0.002)
    assert finer.model.dof_solref[0, 0] == pytest.approx(0.001)
    soft = with_stepping(finer, stepping(scene))
    assert soft.model.dof_solref[0, 0] == 0.02 and stepping(soft) == stepping(scene)


def test_a_friction_that_is_declared_otherwise_stays_so() -> None:
    scene = orbisim.load_scene(CART.format(more=' solreffriction="0.05 1"'))
    assert with_stepping(scene, Stepping(0.001, FAST, dry=True)).model.dof_solref[0, 0] == 0.05
