"""What regressions are made of."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.effects.screening import directions, keyed, positive

from .motion import Motion


def test_a_force_at_the_centre_of_mass_is_mujocos(motion: Motion) -> None:
    force = np.array([1.0, -2.0, 0.5])
    for body in range(1, motion.model.nbody):
        found = motion.body_motion(body).force(force)
        for row, data in zip(found, motion.data, strict=True):
            expected = np.zeros(motion.model.nv)
            point = data.xipos[body].copy()
            mujoco.mj_applyFT(motion.model, data, force, np.zeros(3), point, body, expected)
            np.testing.assert_allclose(row, expected, atol=1e-12)


def test_a_point_mass_falls_and_is_slow_to_turn(motion: Motion) -> None:
    """A free body that is 1 kg at a point beside its frame: Newton's law for that point."""
    ball = motion.model.body("ball").id
    whole = motion.body_motion(ball)
    place = np.array([0.1, -0.2, 0.05])
    arm = np.einsum("mij,j->mi", whole.rotation, place)
    acceleration = whole.acc_origin + np.cross(whole.spin_acc, arm)
    acceleration += np.cross(whole.spin, np.cross(whole.spin, arm))
    found = whole.point_inertia(place)[:, 2:]  # of the free joint: world, then body frame
    np.testing.assert_allclose(found[:, :3], -acceleration, atol=1e-10)
    turning = np.einsum("mji,mj->mi", whole.rotation, np.cross(arm, -acceleration))
    np.testing.assert_allclose(found[:, 3:], turning, atol=1e-10)


def test_directions_are_signs_where_the_speed_is_known() -> None:
    speed = np.array([-1.0, -1e-6, 0.0, 1e-6, 1.0])
    np.testing.assert_allclose(directions(speed, 0.0), np.sign(speed))
    blurred = directions(speed, 1e-3)
    np.testing.assert_allclose(blurred, [-1, -1e-3, 0, 1e-3, 1], atol=1e-9)


def test_coefficients_become_values() -> None:
    assert keyed("a", "b")(np.array([1.0, -2.0])) == {"a": 1.0, "b": -2.0}
    assert positive("a", "b")(np.array([1.0, -2.0])) == {"a": 1.0, "b": -2.0}
    assert positive("a")(np.array([-1.0])) is None
    with pytest.raises(ValueError, match="zip"):
        keyed("a")(np.array([1.0, 2.0]))
