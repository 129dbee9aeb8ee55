"""What mechanisms are made of."""

from __future__ import annotations

import numpy as np

from orbisim.tasks.mechanisms.model import Grip, catch, detents, lock


def test_a_grip_is_a_rotation() -> None:
    grip = Grip("lever", (0, 0, 0), (1, 0, 0), (0, 0, 1))
    np.testing.assert_allclose(grip.rotation @ grip.rotation.T, np.eye(3))
    assert np.linalg.det(grip.rotation) == 1.0
    np.testing.assert_array_equal(grip.rotation[:, 2], [1, 0, 0])


def test_effects_of_a_mechanism() -> None:
    assert lock("leaf", "handle", -0.5, width=0.01, force=100.0).options["side"] == "below"
    assert lock("leaf", "handle", 0.5, width=0.01, force=100.0).options["side"] == "above"
    assert catch("knob", 0.2, 0.05).options == {}
    assert detents("knob", 0.1, 0.3).values["pitch"] == 0.3
