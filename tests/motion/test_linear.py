"""Derivatives and defects of a scene's map over sampling intervals."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.motion.linear import IntervalMap, linearize
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
