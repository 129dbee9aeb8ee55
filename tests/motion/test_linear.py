"""Derivatives and defects of a scene's map over sampling intervals."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.motion.linear import IntervalMap, extrapolated, linearize
from orbisim.motion.samples import prepare_all
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


@pytest.fixture(scope="module")
def flow() -> IntervalMap:
    arm = orbisim.load_scene(ARM)
    runs = inject_effect(arm, [], duration=0.5, episodes=1, noise=0.0, seed=1)
    samples = prepare_all(runs, arm)
    rows = np.flatnonzero(samples[0].usable[:-1] & samples[0].usable[1:])
    return IntervalMap(arm, samples, [rows])


def test_derivatives_predict_what_moved_starts_do(flow: IntervalMap) -> None:
    found, base = linearize(flow), flow.advance()
    rng = np.random.default_rng(0)
    nv = flow.model.nv
    start = 1e-4 * rng.standard_normal((len(flow), 2 * nv))
    push = 1e-3 * rng.standard_normal((len(flow), nv))
    moved = flow.advance(flow.qpos + start[:, :nv], flow.qvel + start[:, nv:], push)
    change = flow.tangent(*base, *moved)
    expected = np.einsum("kij,kj->ki", found.A, start) + np.einsum("kij,kj->ki", found.B, push)
    np.testing.assert_allclose(change, expected, atol=2e-3 * np.abs(expected).max())


def test_a_motion_of_the_scene_itself_has_no_defect(flow: IntervalMap) -> None:
    found = linearize(flow)
    size = np.abs(flow.tangent(flow.qpos, flow.qvel, flow.after_qpos, flow.after_qvel)).max(axis=0)
    assert found.usable.all()
    assert (np.abs(found.defect[2:-2]).max(axis=0) < 0.1 * size).all()  # smoothing at the ends


PENDULUM = """<mujoco><option timestep="{step}" integrator="{integrator}"/><worldbody>
  <body><joint name="hinge" axis="0 1 0" damping=".02"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("integrator", "closer"), [("Euler", 0.1), ("RK4", 0.5)])
def test_what_half_of_a_step_does_tells_what_none_would(integrator: str, closer: float) -> None:
    truth = orbisim.load_scene(PENDULUM.format(step=2e-4, integrator="RK4"))
    scene = orbisim.load_scene(PENDULUM.format(step=0.02, integrator=integrator))
    runs = inject_effect(truth, [], rate=50.0, duration=2.0, episodes=2, noise=1e-9, seed=1)
    samples = prepare_all(runs, scene)
    every = [np.arange(len(one) - 1) for one in samples]
    flow = IntervalMap(scene, samples, every)
    declared, exact = (linearize(IntervalMap(one, samples, every)) for one in (scene, truth))
    found = extrapolated(flow, declared)
    usable = declared.usable & exact.usable
    before, after = (np.abs(one.defect - exact.defect)[usable].max() for one in (declared, found))
    assert after < closer * before
    np.testing.assert_array_equal(found.A, declared.A)


def test_positions_move_along_the_tangent_space() -> None:
    """A free joint has more positions than velocities."""
    scene = orbisim.load_scene(
        "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    model = scene.model
    flow = IntervalMap.__new__(IntervalMap)
    flow.model, flow.qpos = model, np.array([[0.0, 0, 0, 1, 0, 0, 0]])
    turned = flow.moved(5, 0.1)[0]
    expected = np.zeros(4)
    mujoco.mju_axisAngle2Quat(expected, np.array([0.0, 0, 1]), 0.1)
    np.testing.assert_allclose(turned[3:], expected, atol=1e-12)
