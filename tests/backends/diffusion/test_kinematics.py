"""Poses of geoms and cameras against MuJoCo's."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_diffusion.chain import Chain
from orbisim_diffusion.kinematics import Kinematics
from torch.utils._python_dispatch import TorchDispatchMode

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import load_scene, visible
from tests.backends.diffusion.tiny import arm


def test_geoms_and_cameras_are_mujocos() -> None:
    scene = arm()
    model, data = scene.model, mujoco.MjData(scene.model)
    rng = np.random.default_rng(0)
    data.qpos[:] = model.qpos0 + rng.uniform(-0.5, 0.5, model.nq)
    mujoco.mj_normalizeQuat(model, data.qpos)
    mujoco.mj_forward(model, data)
    kinematics = Kinematics(scene, torch.device("cpu"))
    qpos = torch.tensor(data.qpos)[None]
    solids = kinematics.solids(qpos)
    shown = visible.seen(model)
    np.testing.assert_allclose(solids.pos[0], data.geom_xpos[shown], atol=1e-9)
    np.testing.assert_allclose(solids.rot[0], data.geom_xmat[shown].reshape(-1, 3, 3), atol=1e-9)
    for camera in range(model.ncam):
        view = kinematics.view(qpos, camera)
        np.testing.assert_allclose(view.pos[0], data.cam_xpos[camera], atol=1e-9)
        np.testing.assert_allclose(view.rot[0], data.cam_xmat[camera].reshape(3, 3), atol=1e-9)


def test_what_it_cannot_see_is_refused() -> None:
    text = '<mujoco><worldbody><body mocap="true"><geom size="0.1"/></body></worldbody></mujoco>'
    with pytest.raises(UnsupportedSceneError, match="mocap"):
        Kinematics(load_scene(text), torch.device("cpu"))


TREE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body pos="0.1 0.2 0.3" quat="1 0.2 0 0.1">
      <joint axis="0 0 1" pos="0.01 0 0" ref="0.3"/>
      <joint type="slide" axis="1 1 0"/>
      <joint axis="0 1 0.5" pos="0 0.02 0"/>
      <geom size="0.02 0.01 0.03" pos="0.1 0 0" quat="1 0 0.3 0" type="box"/>
      <body pos="0 0 0.1">
        <geom size="0.02"/>
        <body pos="0 0.1 0.1" quat="0.5 0.5 0 0.1">
          <joint type="ball" pos="0 0 0.03"/>
          <geom size="0.01 0.02" type="capsule" pos="0 0.03 0"/>
          <body pos="0.1 0 0"><joint axis="1 0 0"/><geom size="0.01"/></body>
        </body>
      </body>
    </body>
    <body pos="1 2 3" quat="1 1 0 0">
      <freejoint/>
      <geom size="0.03 0.02 0.01" type="box"/>
      <body pos="0 0 0.1"><joint type="slide" axis="0 1 0"/><geom size="0.01"/></body>
    </body>
  </worldbody>
</mujoco>
"""


def test_every_kind_of_joint_moves_its_body_as_in_mujoco() -> None:
    scene = load_scene(TREE)
    model, data = scene.model, mujoco.MjData(scene.model)
    assert set(model.jnt_type) == set(range(4))
    chain, rng = Chain(model, torch.device("cpu")), np.random.default_rng(0)
    states = model.qpos0 + rng.uniform(-0.7, 0.7, (3, model.nq))
    pos, rot = chain.bodies(torch.as_tensor(states))
    for world, qpos in enumerate(states):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(pos[world], data.xpos, atol=1e-9)
        np.testing.assert_allclose(rot[world], data.xmat.reshape(-1, 3, 3), atol=1e-9)


def test_poses_have_gradients_to_every_coordinate() -> None:
    chain = Chain(load_scene(TREE).model, torch.device("cpu"))
    qpos = torch.as_tensor(load_scene(TREE).model.qpos0 + 0.1)[None].requires_grad_(True)
    assert torch.autograd.gradcheck(
        lambda q: torch.cat([v.flatten() for v in chain.bodies(q)]), qpos
    )


class _Started(TorchDispatchMode):
    """Counts the operations that are not views."""

    count = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):  # type: ignore[no-untyped-def]
        self.count += not func.is_view
        return func(*args, **(kwargs or {}))


def test_a_longer_chain_starts_hardly_more_kernels() -> None:
    """A GPU's time goes into starting them: doubling the bodies adds one product."""

    def started(bodies: int) -> int:
        text = "<geom size='0.01'/>"
        for _ in range(bodies):
            text = f"<body pos='0 0 0.1'><joint/><geom size='0.01'/>{text}</body>"
        model = load_scene(f"<mujoco><worldbody>{text}</worldbody></mujoco>").model
        chain, qpos = Chain(model, torch.device("cpu")), torch.zeros(1, bodies)
        chain.bodies(qpos)
        with _Started() as mode:
            chain.bodies(qpos)
        return mode.count

    few, many = started(8), started(32)
    assert many - few <= 6
