"""Poses of geoms and cameras against MuJoCo's."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_diffusion.kinematics import Kinematics

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
