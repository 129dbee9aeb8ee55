"""Transforms of bodies and joints, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from orbisim_world_model.frames import axis_frame, motion, nested, transform
from scipy.spatial.transform import Rotation


@pytest.mark.parametrize("q", [-2.0, 0.0, 0.7])
def test_a_hinge_turns_about_z_from_its_reference(q: float) -> None:
    parts = motion(True, reference=0.3)
    found = sum(c * part for c, part in zip((1, np.sin(q), np.cos(q), q), parts, strict=True))
    expected = np.eye(4)
    expected[:3, :3] = Rotation.from_euler("z", q - 0.3).as_matrix()
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("q", [-2.0, 0.7])
def test_a_slide_moves_along_z_from_its_reference(q: float) -> None:
    parts = motion(False, reference=0.3)
    found = sum(c * part for c, part in zip((1, np.sin(q), np.cos(q), q), parts, strict=True))
    expected = np.eye(4)
    expected[2, 3] = q - 0.3
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_frames_of_axes() -> None:
    axis, anchor = np.array([1.0, 2.0, -2.0]) / 3, np.array([0.1, 0.2, 0.3])
    frame = axis_frame(axis, anchor)
    np.testing.assert_allclose(frame[:3, 2], axis, atol=1e-12)
    np.testing.assert_allclose(frame[:3, 3], anchor)
    np.testing.assert_allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3), atol=1e-12)
    rotation = Rotation.from_rotvec([0.3, -0.2, 0.1])
    found = transform(anchor, rotation.as_quat(scalar_first=True))
    np.testing.assert_allclose(found[:3, :3], rotation.as_matrix(), atol=1e-12)


def test_nested_numbers() -> None:
    assert nested(np.array([[1, 2], [3, 4]])) == ((1.0, 2.0), (3.0, 4.0))
