"""Limbs as the learned model sees them, against MuJoCo's own kinematics and distances."""

from __future__ import annotations

import dataclasses
import shutil

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.layout import Layout
from orbisim_world_model.native import NativeStep
from orbisim_world_model.reading import read_layout
from orbisim_world_model.touch import Touch, along, closest
from orbisim_world_model.trainer import Trainer, new_model

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import PENDULUM, simulate

WALKER = """
<mujoco model="walker">
  <option timestep="0.005"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1" pos="0 0 0.02"/>
    <body name="torso" pos="0 0 0.9">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 -0.2 0.05 0 0.2" size="0.05"/>
      <body name="left" pos="0 0.1 -0.2">
        <joint name="hip" axis="0 1 0.2" pos="0.01 0 0" range="-1 1.2" limited="true"/>
        <geom type="capsule" size="0.03 0.15" pos="0 0 -0.15" euler="0 20 10"/>
        <body name="foot" pos="0 0 -0.35">
          <joint name="ankle" axis="0 1 0" ref="0.3"/>
          <geom type="sphere" size="0.05"/>
        </body>
      </body>
      <body name="right" pos="0 -0.1 -0.2">
        <joint name="other" axis="0 1 0" range="-1 1" limited="true"/>
        <geom type="capsule" size="0.03 0.2" pos="0 0 -0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="hip" ctrllimited="true" ctrlrange="-1 1"/>
    <motor joint="other" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def walker() -> tuple[mujoco.MjModel, mujoco.MjData, Layout]:
    model = mujoco.MjModel.from_xml_string(WALKER)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[:], data.qvel[:] = rng.uniform(-1, 1, (2, model.nv))
    mujoco.mj_forward(model, data)
    layout = read_layout(model, 0.01)
    return model, data, dataclasses.replace(layout, ignored=(False,) * len(layout.joints))


def state(data: mujoco.MjData) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor(data.qpos)[None], torch.tensor(data.qvel)[None]


def test_ends_of_capsules_are_where_mujoco_has_them(
    walker: tuple[mujoco.MjModel, mujoco.MjData, Layout],
) -> None:
    model, data, layout = walker
    capsules = Touch(layout).double().kinematics(*state(data))
    jacobian = np.zeros((3, model.nv))
    for number, geom in enumerate(range(1, model.ngeom)):
        round_ = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE
        for side, sign in enumerate((-1, 1)):
            half = sign * model.geom_size[geom, 1] * round_
            point = data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3)[:, 2] * half
            mujoco.mj_jac(model, data, jacobian, None, point, model.geom_bodyid[geom])
            found = capsules.ends[0, number, side], capsules.speeds[0, number, side]
            np.testing.assert_allclose(found[0], point, atol=1e-6)
            np.testing.assert_allclose(found[1], jacobian @ data.qvel, atol=1e-6)


def test_distances_of_pairs_are_mujocos(
    walker: tuple[mujoco.MjModel, mujoco.MjData, Layout],
) -> None:
    model, data, layout = walker
    limbs = layout.limbs
    assert limbs.pairs == ((0, 2), (1, 3), (2, 3)) and limbs.grounded == (0, 1, 2, 3)
    ends = Touch(layout).double().kinematics(*state(data)).ends
    for i, j in limbs.pairs:
        a, b = ends[:, [i]], ends[:, [j]]
        shares = closest(a, b)
        apart = float((along(b, shares[1]) - along(a, shares[0])).norm())
        expected = mujoco.mj_geomDistance(model, data, i + 1, j + 1, 10.0, np.zeros(6))
        assert apart - limbs.radii[i] - limbs.radii[j] == pytest.approx(expected, abs=1e-6)


def test_nothing_depends_on_how_far_it_has_walked() -> None:
    layout = read_layout(mujoco.MjModel.from_xml_string(WALKER), 0.01)
    assert layout.ignored[0] and Layout.from_dict(layout.to_dict()) == layout
    features = Touch(layout)
    q, v = 0.3 * torch.ones(2, len(layout.joints)), torch.ones(2, len(layout.joints))
    q[1, 0] += 50.0
    found = features(q, v)
    assert torch.equal(found[0], found[1]) and bool(torch.isfinite(found).all())


def test_the_model_sees_limbs_only_if_asked() -> None:
    pack = simulate(WALKER, 2, 10, 2)
    sizes = [_seen(pack.layout, touch) for touch in (False, True)]
    assert sizes[1] > sizes[0]


def _seen(layout: Layout, touch: bool) -> int:
    model = Dynamics(layout, toy(model__touch=touch).model).build(layout.nu)
    return int(model.sizes.robot)


@pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler")
def test_the_compiled_step_knows_limbs() -> None:
    pack = simulate(WALKER, 2, 20, 2)
    model = new_model(pack, toy(model__touch=True), 0).eval().requires_grad_(False)
    context = pack.context(torch.zeros(1, dtype=torch.long))._replace(mask=None)
    native, memory = NativeStep(model, context), model.initial_memory(1)
    for row in (0, 11):
        rows = slice(row, row + 1)
        inputs = [pack.qpos[rows], pack.qvel[rows], pack.act[rows]]
        after = model(pack.layout.split(*inputs), memory, pack.ctrl[rows], context)
        found = native(*(t.numpy() for t in (*inputs, pack.ctrl[rows], memory)))
        for ours, theirs in zip(found, pack.layout.join(after.state), strict=False):
            np.testing.assert_allclose(ours, theirs.numpy(), atol=2e-4, rtol=1e-3)


@pytest.mark.slow  # torch.compile
def test_compiled_training_is_the_same_training(monkeypatch: pytest.MonkeyPatch) -> None:
    import functools

    from orbisim_world_model.schedule import Clock

    monkeypatch.setattr(torch, "compile", functools.partial(torch.compile, backend="eager"))
    pack = simulate(PENDULUM, 3, 10, 1)
    config = toy("default", "0.5x1x8,0.5x3x8arf", model__width=8, model__layers=1)
    losses = []
    for compiled in (False, True):
        trainer = Trainer(pack, config, Clock(6, None), compiled=compiled)
        for _ in range(6):
            trainer.step()
        losses.append(trainer.losses()["loss"])
    assert losses[1] == pytest.approx(losses[0], rel=1e-4)
