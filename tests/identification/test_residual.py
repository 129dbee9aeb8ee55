"""Errors of positions and rotations in their units, and which coordinates count."""

from __future__ import annotations

import mujoco
import torch

from orbisim import load_scene
from orbisim.identification.parameters import parameters
from orbisim.identification.residual import counted, errors
from orbisim.identification.windows import JOINT, PLACE, TURN
from tests.identification.test_parameters import XML


def test_units_signs_and_what_was_not_recorded() -> None:
    turn = 0.01
    target = torch.tensor([[[0.2, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]]], dtype=torch.float64)
    found = target.clone()
    found[..., 0] += 0.02
    found[..., 1] += 0.004
    half = torch.tensor(turn / 2)
    found[..., 4:] = torch.stack([half.cos(), half.sin(), half * 0, half * 0])
    for sign in (1.0, -1.0):  # a quaternion and its negative are the same rotation
        turned = target.clone()
        turned[..., 4:] *= sign
        got = errors(found, turned, [0], [1])[0]
        expected = torch.tensor([0.02 / JOINT, 0.004 / PLACE, 0, 0, turn / TURN, 0, 0])
        torch.testing.assert_close(got, expected.double(), atol=1e-5, rtol=1e-4)
    target[..., 2] = float("nan")
    assert errors(found, target, [], [1])[0, 1] == 0
    lost = errors(torch.full_like(found, torch.nan), target, [], [1])[0]
    assert lost[1] == 0 and lost[[0, 2, 3, 4, 5]].isnan().all()  # diverged is not "no error"


def test_joints_count_where_their_numbers_are_sought() -> None:
    scene = load_scene(XML)
    assert isinstance(scene.model, mujoco.MjModel)
    assert counted(scene.model, parameters(scene, "density")) == ([], [0])
    assert counted(scene.model, parameters(scene, "damping")) == ([7], [0])
