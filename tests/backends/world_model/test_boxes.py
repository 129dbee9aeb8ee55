"""Gaps between boxes, against MuJoCo's own distances."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from orbisim_world_model.boxes import Boxes, contact_point, separation
from orbisim_world_model.rotation import to_matrix

_PAIR = """
<mujoco><worldbody>
  <body mocap="true"><geom type="box" size="0.02 0.03 0.04"/></body>
  <body mocap="true"><geom type="box" size="0.03 0.03 0.02"/></body>
</worldbody></mujoco>
"""


def _boxes(pos: np.ndarray, quat: np.ndarray, half: list[float]) -> Boxes:
    place = torch.as_tensor(pos, dtype=torch.float32)[:, None]
    turn = to_matrix(torch.as_tensor(quat, dtype=torch.float32))[:, None]
    zero = torch.zeros_like(place)
    return Boxes(place, turn, torch.tensor(half).expand(place.shape), zero, zero)


def test_gaps_against_mujoco() -> None:
    model = mujoco.MjModel.from_xml_string(_PAIR)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    pos, quat, truth = [], [], []
    for _ in range(400):
        data.mocap_pos[:] = rng.normal(0, 0.03, (2, 3))
        turn = rng.normal(size=(2, 4))
        data.mocap_quat[:] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
        mujoco.mj_kinematics(model, data)
        truth.append(mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None))
        pos.append(data.mocap_pos.copy())
        quat.append(data.mocap_quat.copy())
    places, turns, distance = np.array(pos), np.array(quat), np.array(truth)
    a = _boxes(places[:, 0], turns[:, 0], [0.02, 0.03, 0.04])
    b = _boxes(places[:, 1], turns[:, 1], [0.03, 0.03, 0.02])
    gap, direction = (part[:, 0].numpy() for part in separation(a, b))
    clear = np.abs(distance) > 5e-4
    assert ((gap > 0) == (distance > 0))[clear].all()  # touch or not: exact
    assert (distance > 0)[clear].sum() > 50 and (distance < 0)[clear].sum() > 50
    assert (gap <= np.maximum(distance, 0) + 2e-4)[distance > 0].all()  # apart: a lower bound
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-3)
    assert ((places[:, 1] - places[:, 0]) * direction).sum(1).min() >= 0
    # moved apart by the depth, along the direction, they just touch
    deep = gap < -1e-4
    moved = b._replace(pos=b.pos - torch.as_tensor((direction * gap[:, None])[:, None]))
    after = separation(a, moved)[0][:, 0].numpy()[deep]
    assert np.abs(after).max() < 3e-4


def test_where_faces_touch() -> None:
    zero, turn = np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]])
    a = _boxes(zero, turn, [0.02, 0.02, 0.02])
    b = _boxes(zero + [0.04, 0.03, 0.0], turn, [0.02, 0.02, 0.02])
    gap, direction = separation(a, b)
    np.testing.assert_allclose(gap, 0.0, atol=1e-6)
    np.testing.assert_allclose(direction[0, 0], [1, 0, 0], atol=1e-6)
    # corners of each within the other's face: the middle of the patch, y from 0.01 to 0.02
    np.testing.assert_allclose(contact_point(a, b)[0, 0], [0.02, 0.015, 0.0], atol=1e-3)


def test_later_and_speed() -> None:
    zero, turn = np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]])
    box = _boxes(zero, turn, [0.02, 0.02, 0.02])
    box = box._replace(vel=box.vel + 1.0, ang=torch.tensor([[[0.0, 0.0, np.pi / 2]]]))
    later = box.later(1.0)
    np.testing.assert_allclose(later.pos[0, 0], [1, 1, 1])
    np.testing.assert_allclose(later.rot[0, 0, :, 0], [0, 1, 0], atol=1e-6)
    point = box.pos + torch.tensor([1.0, 0.0, 0.0])
    np.testing.assert_allclose(box.speed_at(point)[0, 0], [1, 1 + np.pi / 2, 1], rtol=1e-6)
