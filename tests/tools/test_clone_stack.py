"""What a cloned policy of `task:stack` sees."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "tools"))

import clone_stack


def turned(angles: object) -> np.ndarray:
    """Quaternions, the real part first."""
    return Rotation.from_euler("xyz", angles).as_quat()[..., [3, 0, 1, 2]]


def test_the_turn_of_a_cube_that_lies_on_any_face() -> None:
    for roll in (0.0, np.pi / 2, np.pi, -np.pi / 2):
        found = clone_stack.flat_yaw(turned([[roll, 0.0, 0.3]]))
        assert np.isclose(np.sin(4 * (found - 0.3)), 0.0, atol=1e-6).all()
        assert np.isclose(np.cos(4 * (found - 0.3)), 1.0, atol=1e-6).all()


def seen(count: int = 2) -> clone_stack.Seen:
    rng = np.random.default_rng(0)
    return clone_stack.Seen(
        command=rng.normal(size=(count, 3)),
        told=rng.normal(size=count),
        fingers=np.zeros((count, 2)),
        grip=-np.ones(count),
        changes=np.zeros(count),
        age=np.arange(count),
        cubes=rng.normal(size=(count, 3, 3)),
        yaw=rng.normal(size=(count, 3)),
    )


def test_a_quarter_turn_of_a_cube_is_not_seen() -> None:
    one = seen()
    other = dataclasses.replace(one, yaw=one.yaw + np.array([np.pi / 2, -np.pi / 2, np.pi]))
    np.testing.assert_allclose(one.features(), other.features(), atol=1e-5)
    moved = dataclasses.replace(one, yaw=one.yaw + 0.1)
    assert np.abs(one.features() - moved.features()).max() > 0.1


def test_errors_of_measurement() -> None:
    one, rng = seen(4000), np.random.default_rng(1)
    assert one.blurred(0.0, rng) is one
    blurred = one.blurred(0.01, rng)
    assert np.std(blurred.cubes - one.cubes) == pytest.approx(0.01, rel=0.05)
    assert np.std(blurred.yaw - one.yaw) == pytest.approx(np.deg2rad(2.0), rel=0.05)
    np.testing.assert_array_equal(blurred.command, one.command)  # is known, not measured
