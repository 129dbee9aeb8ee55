"""The hand, against C MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from orbisim_world_model.kinematics import Kinematics
from orbisim_world_model.packing import check_kinematics
from orbisim_world_model.reading import read_layout

ARM = """
<mujoco>
  <worldbody>
    <body pos="0.1 0 0.2" euler="10 20 30">
      <joint name="a" axis="0.3 1 0" pos="0.05 0 0.1" ref="20"/>
      <geom size="0.05"/>
      <body pos="0 0.2 0.3" quat="0.9 0.1 0.2 0.3">
        <joint name="b" type="slide" axis="1 0.2 0" ref="0.1"/>
        <joint name="c" axis="0 0 1" pos="0 0.1 0"/>
        <geom size="0.05"/>
        <body pos="0.3 0 0"><geom size="0.02"/>
          <body pos="0 0 0.1"><joint name="d" axis="-1 0 0"/><geom size="0.02"/>
            <site name="tcp" pos="0.02 0.03 0.04" euler="5 6 7"/></body></body>
      </body>
    </body>
    <body pos="1 0 0"><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def test_the_hand_is_where_mujoco_has_it() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    layout = read_layout(model, 0.01)
    rng = np.random.default_rng(0)
    qpos = np.tile(model.qpos0, (20, 1))
    qpos[:, list(layout.joint_q)] += rng.normal(0.0, 1.0, (20, 4))
    assert check_kinematics(model, layout, qpos) < 1e-6


def test_the_hand_moves_as_its_positions_do() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    layout = read_layout(model, 0.01)
    kinematics = Kinematics(layout).double()
    rng = np.random.default_rng(1)
    q, v = (torch.tensor(rng.normal(size=(5, 4))) for _ in range(2))
    eps = 1e-6
    ahead, behind = kinematics(q + eps * v, v), kinematics(q - eps * v, v)
    slope = (ahead[:, :3] - behind[:, :3]) / (2 * eps)
    torch.testing.assert_close(kinematics(q, v)[:, 12:15], slope, atol=1e-5, rtol=0)


def test_the_hand_turns_as_mujoco_says() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    layout = read_layout(model, 0.01)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    data.qpos[list(layout.joint_q)] += rng.normal(size=4)
    data.qvel[list(layout.joint_v)] = rng.normal(size=4)
    mujoco.mj_forward(model, data)
    velocity = np.zeros(6)
    site = model.site("tcp").id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 0)
    q, v = (torch.tensor(row[None]) for row in (data.qpos[list(layout.joint_q)],
                                               data.qvel[list(layout.joint_v)]))  # fmt: skip
    hand = Kinematics(layout).double()(q, v)[0].numpy()
    np.testing.assert_allclose(hand[15:18], velocity[:3], atol=1e-5)
    np.testing.assert_allclose(hand[12:15], velocity[3:], atol=1e-5)
    np.testing.assert_allclose(hand[3:12], data.site_xmat[site], atol=1e-6)
