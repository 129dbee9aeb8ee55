"""Quaternions, and the smoothing of orientations."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from orbisim.recording import quaternions as quat
from orbisim.recording import smooth_rotation

vectors = hnp.arrays(np.float64, (4, 3), elements=st.floats(-1.7, 1.7))


@given(vectors, vectors)
@settings(deadline=None)
def test_algebra_against_scipy(a, b):
    p, q = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    product = quat.multiply(quat.exp(a), quat.exp(b))
    np.testing.assert_allclose(quat.log(product), (p * q).as_rotvec(), atol=1e-9)
    np.testing.assert_allclose(quat.rotate(quat.exp(a), b), p.apply(b), atol=1e-12)
    np.testing.assert_allclose(quat.log(quat.exp(a)), a, atol=1e-12)
    np.testing.assert_allclose(quat.log(-quat.exp(a)), a, atol=1e-12)


@given(vectors, vectors)
@settings(deadline=None)
def test_rate_of_the_rotation_vector(r, rate):
    """exp(r + h r') is exp(r) exp(h rate) to first order, with the body-frame rate."""
    h = 1e-6
    slope = quat.body_rate_at_end(r, rate)
    ahead = quat.log(quat.multiply(quat.exp(r), quat.exp(h * rate)))
    np.testing.assert_allclose((ahead - r) / h, slope, atol=1e-4)


def test_signs_become_continuous():
    t = np.linspace(0, 12, 100)
    q = quat.exp(np.stack([t, 0 * t, 0 * t], axis=1))
    flipped = q * np.random.default_rng(0).choice([-1.0, 1.0], (100, 1))
    flipped[40:43] = np.nan
    found = quat.continuous(flipped)
    seen = np.isfinite(found[:, 0])
    steps = (found[seen][1:] * found[seen][:-1]).sum(axis=1)
    assert (steps > 0.9).all()
    assert np.isnan(found[40:43]).all()


def tumbling(count, interval):
    """Orientation, body rates and accelerations of a free rigid body, by fine integration."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><option timestep='1e-4' gravity='0 0 0' integrator='RK4'/><worldbody><body>"
        "<freejoint/><geom type='box' size='.1 .2 .3'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[3:] = (1.0, 4.0, -2.0)
    quats, rates, accelerations = [], [], []
    every = round(interval / 1e-4)
    for _ in range(count):
        mujoco.mj_forward(model, data)
        quats.append(data.qpos[3:7].copy())
        rates.append(data.qvel[3:].copy())
        accelerations.append(data.qacc[3:].copy())
        for _ in range(every):
            mujoco.mj_step(model, data)
    return np.arange(count) * interval, *map(np.array, (quats, rates, accelerations))


@pytest.mark.parametrize("std", [0.0, 2e-3])
def test_rates_are_in_the_body_frame(std):
    t, q, w, dw = tumbling(600, 5e-3)
    rng = np.random.default_rng(0)
    noisy = quat.multiply(q, quat.exp(std * rng.standard_normal((len(q), 3))))
    noisy[100:104] = np.nan
    noisy[200:] *= -1
    found = smooth_rotation(t, noisy)
    inside = slice(20, -20)
    scale = np.abs(w).max()
    error = np.sqrt(np.mean((found.angvel - w)[inside] ** 2))
    assert error < (1e-6 if std == 0 else 0.01) * scale
    assert np.sqrt(np.mean((found.angacc - dw)[inside] ** 2)) < (1e-3 if std == 0 else 1.5)
    if std:
        assert found.noise_std == pytest.approx(std, rel=0.1)
        assert 0.3 < error / found.angvel_std[inside].mean() < 1.3
    np.testing.assert_allclose(np.linalg.norm(found.quat, axis=1), 1, rtol=1e-12)


@pytest.mark.parametrize("turn", [0.5, 0.8, 1.2])
def test_a_fast_spin_is_known_at_the_ends(turn: float) -> None:
    """Of a ball that turns by so much from sample to sample, about an axis of its own."""
    rng, interval, count = np.random.default_rng(1), 8e-3, 90
    t = interval * np.arange(count)
    w = turn / interval * np.array([0.6, -0.64, 0.48])
    q = quat.multiply(quat.exp(np.array([0.3, 1.0, -0.2])), quat.exp(w * t[:, None]))
    noisy = quat.multiply(q, quat.exp(4e-3 * rng.standard_normal((count, 3))))
    noisy[40:43] = np.nan
    found = smooth_rotation(t, noisy)
    assert np.abs(found.angvel - w).max() < 0.02 * np.linalg.norm(w)
    assert found.noise_std == pytest.approx(4e-3, rel=0.3)
    off = quat.log(quat.multiply(quat.conjugate(q), found.quat))
    assert np.abs(off).max() < 0.02
