"""What a cloned policy of `task:stack` sees."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent.parent.parent.parent / "tools"))

from cloning.seen import OWN, Seen, flat_yaw, turned

YAWS = np.linspace(-1.0, 1.0, 40).reshape(10, 4)


def quaternions(angles: object) -> np.ndarray:
    """The real part first."""
    return Rotation.from_euler("xyz", angles).as_quat()[..., [3, 0, 1, 2]]


def test_the_turn_of_a_cube_that_lies_on_any_face() -> None:
    for roll in (0.0, np.pi / 2, np.pi, -np.pi / 2):
        found = flat_yaw(quaternions([[roll, 0.0, 0.3]]))
        assert np.isclose(np.sin(4 * (found - 0.3)), 0.0, atol=1e-6).all()
        assert np.isclose(np.cos(4 * (found - 0.3)), 1.0, atol=1e-6).all()


def seen(count: int = 8) -> Seen:
    rng = np.random.default_rng(0)
    return Seen(
        command=rng.normal(size=(count, 3)),
        told=rng.normal(size=count),
        fingers=np.zeros((count, 2)),
        grip=-np.ones(count),
        changes=np.arange(count) % 6.0,
        age=np.arange(count, dtype=float),
        source=np.arange(count) % 10,
        cubes=rng.normal(size=(count, 3, 3)),
        yaw=rng.normal(size=(count, 3)),
    )


def test_a_quarter_turn_of_a_cube_is_not_seen() -> None:
    one = seen()
    other = dataclasses.replace(one, yaw=one.yaw + np.array([np.pi / 2, -np.pi / 2, np.pi]))
    np.testing.assert_allclose(one.features(YAWS), other.features(YAWS), atol=1e-4)
    moved = dataclasses.replace(one, yaw=one.yaw + 0.1)
    assert np.abs(one.features(YAWS) - moved.features(YAWS)).max() > 0.1


def test_a_turn_of_everything_is_not_seen_but_by_the_robot_itself() -> None:
    one, angle = seen(), 1e-3  # no cube comes to look best from another side
    other = dataclasses.replace(
        one,
        command=turned(one.command, np.array(angle)),
        told=one.told + angle,
        cubes=turned(one.cubes, np.array(angle)),
        yaw=one.yaw + angle,
    )
    before, after = one.features(YAWS)[:, OWN:], other.features(YAWS)[:, OWN:]
    np.testing.assert_allclose(before, after, atol=1e-4)
    assert np.abs(one.own() - other.own()).max() > 1e-3


def test_errors_of_measurement() -> None:
    one, rng = seen(4000), np.random.default_rng(1)
    assert one.blurred(0.0, rng) is one
    blurred = one.blurred(0.01, rng)
    assert np.std(blurred.cubes - one.cubes) == pytest.approx(0.01, rel=0.05)
    assert np.std(blurred.yaw - one.yaw) == pytest.approx(np.deg2rad(2.0), rel=0.05)
    np.testing.assert_array_equal(blurred.command, one.command)  # is known, not measured
