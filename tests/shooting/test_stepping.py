"""How a scene is stepped, and the same scene stepped otherwise."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting.stepping import Stepping, stepping, with_stepping, within_samples
from orbisim.testing import inject_effect

CART = """<mujoco><option timestep="0.0002" gravity="0 0 0" integrator="implicitfast"/><worldbody>
<body><joint name="slide" type="slide" axis="1 0 0" frictionloss="2"{more}/>
<geom size=".05" mass="1"/></body></worldbody></mujoco>"""
FAST = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)


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


def test_a_stepping_says_what_it_is() -> None:
    told = str(Stepping(0.0002, FAST, dry=True))
    assert "0.0002 s" in told and "implicitfast" in told and "solreffriction" in told
    assert "solreffriction" not in str(Stepping(0.0002, FAST))
    assert "elliptic" in str(Stepping(0.0002, FAST, elliptic=True))
    assert "elliptic" not in str(Stepping(0.0002, FAST))


def test_cones_are_as_asked_for() -> None:
    scene = orbisim.load_scene(CART.format(more=""))
    assert not stepping(scene).elliptic
    elliptic = with_stepping(scene, stepping(scene)._replace(elliptic=True))
    assert elliptic.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and stepping(elliptic).elliptic
    assert stepping(with_stepping(elliptic, stepping(scene))) == stepping(scene)
