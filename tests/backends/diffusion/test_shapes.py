"""Rays against MuJoCo's own, and gradients against finite differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_diffusion import raycast
from orbisim_diffusion.kinematics import Kinematics
from orbisim_diffusion.raycast import cast, shade
from orbisim_diffusion.shapes import PRIMITIVES
from orbisim_diffusion.solids import Lamps, rays

from orbisim.scene import load_scene
from tests.backends.diffusion.tiny import arm

KINDS = {
    "plane": 'type="plane" size="0.5 0.4 0.1"',
    "sphere": 'type="sphere" size="0.3"',
    "capsule": 'type="capsule" size="0.15 0.25"',
    "ellipsoid": 'type="ellipsoid" size="0.3 0.2 0.15"',
    "cylinder": 'type="cylinder" size="0.2 0.25"',
    "box": 'type="box" size="0.2 0.3 0.15"',
    "mesh": 'type="mesh" mesh="wedge"',
}
SCENE = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.4 0 0  0 0.4 0  0 0 0.4  0.4 0.4 0.2"/>
  </asset>
  <worldbody>
    <camera name="eye" pos="0.1 -1.2 0.7" xyaxes="1 0.1 0 0 0.5 0.86" fovy="50"/>
    <body><freejoint/><geom {} quat="0.9 0.3 0.2 0.1"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("kind", KINDS)
def test_depth_and_normals_are_mujocos(kind: str) -> None:
    text = SCENE.format(KINDS[kind])
    scene = load_scene(text.replace("<freejoint/>", "") if kind == "plane" else text)
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_forward(model, data)
    kinematics = Kinematics(scene, torch.device("cpu"))
    qpos = torch.tensor(data.qpos)[None].float()
    view, size = kinematics.view(qpos, 0), 48
    buffers = cast(kinematics.solids(qpos), view, size, size, kinematics.meshes)
    forward = rays(view, size, size)[0].double().numpy()
    geom = np.zeros(1, np.int32)
    checked = 0
    for pixel, ray in enumerate(forward):
        unit = ray / np.linalg.norm(ray)
        t = mujoco.mj_ray(model, data, data.cam_xpos[0], unit, None, 1, -1, geom)
        share = float(buffers.weight[0, 0].flatten()[pixel])
        depth = float(buffers.depth[0].flatten()[pixel])
        if share > 0.999:
            assert t > 0
            assert depth == pytest.approx(t / np.linalg.norm(ray), rel=5e-3)
            checked += 1
        elif share < 1e-3:
            assert t < 0
    assert checked > 20
    inside = buffers.weight[0, 0] > 0.999
    lengths = buffers.normal[0].norm(dim=0)[inside]
    torch.testing.assert_close(lengths, torch.ones_like(lengths), atol=5e-3, rtol=0)
    assert (buffers.normal[0, 2][inside] > -0.05).all()  # towards the camera


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in ("mesh", "plane")])
def test_gradients_are_finite_differences_silhouettes_included(kind: str) -> None:
    scene = load_scene(SCENE.format(KINDS[kind]))
    kinematics = Kinematics(scene, torch.device("cpu"))
    weights = torch.linspace(-1, 1, 16 * 16, dtype=torch.float64).reshape(16, 16)

    def value(qpos: torch.Tensor) -> torch.Tensor:
        solids, view = kinematics.solids(qpos[None]), kinematics.view(qpos[None], 0)
        buffers = cast(solids, view, 16, 16)
        return (buffers.weight[0, 0] * weights).sum() + 0.1 * (buffers.depth[0] * weights).sum()

    qpos = torch.tensor(scene.model.qpos0, requires_grad=True)
    (gradient,) = torch.autograd.grad(value(qpos), qpos)
    assert gradient.abs().max() > 1e-3
    for i in range(3):
        step = torch.zeros_like(qpos)
        step[i] = 1e-6
        with torch.no_grad():
            slope = (value(qpos + step) - value(qpos - step)) / 2e-6
        assert float(gradient[i]) == pytest.approx(float(slope), rel=0.02, abs=2e-3)


def test_what_is_in_the_way_of_a_light_throws_a_shadow() -> None:
    scene = load_scene(
        """
        <mujoco><worldbody>
          <light directional="true" dir="0 0 -1"/>
          <camera name="eye" pos="0 -0.01 3" xyaxes="1 0 0 0 1 0"/>
          <geom type="plane" size="2 2 0.1"/>
          <body pos="0.5 0 1"><freejoint/><geom type="box" size="0.2 0.2 0.05"/></body>
        </worldbody></mujoco>
        """
    )
    kinematics = Kinematics(scene, torch.device("cpu"))
    qpos = torch.tensor(scene.model.qpos0)[None].float()
    solids, view = kinematics.solids(qpos), kinematics.view(qpos, 0)
    buffers = cast(solids, view, 64, 64)
    free, lit = shade(buffers, solids, view, kinematics.lamps(1))
    floor = buffers.weight[0, 0] > 0.999
    under = (buffers.point[0, 0] - 0.5).abs().le(0.18) & buffers.point[0, 1].abs().le(0.18) & floor
    apart = (buffers.point[0, 0] < 0.0) & floor
    assert under.any()
    assert float(free[0][under].max()) < 0.01
    assert float(free[0][apart].min()) > 0.99
    assert float(lit[0][apart].min()) > 0.98  # the light falls straight down


def test_every_primitive_is_tried() -> None:
    numbers = {int(getattr(mujoco.mjtGeom, f"mjGEOM_{k.upper()}")) for k in KINDS if k != "mesh"}
    assert numbers == set(PRIMITIVES)


def test_lights_at_once_or_one_after_another_throw_the_same_shadows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = arm()
    kinematics = Kinematics(scene, torch.device("cpu"))
    qpos = torch.tensor(scene.model.qpos0)[None].float()
    solids, view, lamps = kinematics.solids(qpos), kinematics.view(qpos, 0), kinematics.lamps(1)
    assert lamps.rows.shape[1] == 2
    buffers = cast(solids, view, 32, 32)
    together = shade(buffers, solids, view, lamps)
    monkeypatch.setattr(raycast, "_PAIRS", 1)
    for a, b in zip(together, shade(buffers, solids, view, lamps), strict=True):
        torch.testing.assert_close(a, b)
    one = shade(buffers, solids, view, Lamps(lamps.rows[:, :1]))
    assert float((together[0] - one[0]).abs().max()) > 0.1  # both lights count


def test_types_that_are_known_beforehand_change_nothing() -> None:
    scene = arm()
    kinematics = Kinematics(scene, torch.device("cpu"))
    qpos = torch.as_tensor(scene.model.qpos0).float().repeat(2, 1)
    qpos[1, 0] += 0.3
    solids, view = kinematics.solids(qpos), kinematics.view(qpos, 0)
    kinds = tuple(int(kind) for kind in kinematics.rows[:, 0])
    lamps = kinematics.lamps(2)
    plain = cast(solids, view, 24, 24)
    known = cast(solids, view, 24, 24, kinds=kinds)
    for one, other in zip(plain, known, strict=True):
        assert torch.equal(one, other)
    for one, other in zip(
        shade(plain, solids, view, lamps),
        shade(known, solids, view, lamps, kinds=kinds),
        strict=True,
    ):
        assert torch.equal(one, other)
