"""Robots of limbs for tests: trees of hinges and slides over a floor."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from orbisim_world_model.dynamics import Dynamics, example
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.presets import preset
from orbisim_world_model.reading import read_settings
from orbisim_world_model.reading_articulation import limb_rows, natural_step, read_articulated

CRAWLER = """
<mujoco model="crawler">
  <option timestep="0.005"/>
  <default><geom type="capsule" size="0.04" friction="0.8 0.01 0.01"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" friction="1 0.005 0.0001"/>
    <body name="torso" pos="0 0 0.4">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1" ref="0.4"/>
      <joint name="pitch" axis="0 1 0" pos="0.02 0 0"/>
      <geom fromto="-.2 0 0 .2 0 0"/>
      <body name="lead" pos="0 0 0.1"><geom type="sphere" size="0.05" mass="0.7"/></body>
      <body name="leg" pos=".2 0 0" quat="0.9 0.1 0.2 0">
        <joint name="hip" axis="0 1 0.2" pos="0.01 0 0.02" range="-60 40" damping="0.4"
          armature="0.01" stiffness="2" springref="0.2" limited="true"/>
        <geom fromto="0 0 0 0 0 -.3"/>
        <body name="foot" pos="0 0 -.3">
          <joint name="ankle" type="slide" axis="0 0 1" damping="3" frictionloss="0.3"/>
          <geom fromto="-.05 0 0 .1 0 0" size="0.03"/>
        </body>
      </body>
      <body name="tail" pos="-.2 0 0">
        <joint name="tail" axis="0 1 0" damping="0.2"/>
        <geom fromto="0 0 0 -.25 0 .05"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="tail" gear="3" ctrlrange="-1 1" ctrllimited="true"/>
    <position joint="hip" kp="20" kv="2" ctrlrange="-0.8 0.5" forcerange="-6 6"/>
  </actuator>
</mujoco>
"""
"""Several joints on a body, a body welded to it, springs, a servo, dry friction, contacts."""

TWO = """
<mujoco model="two links">
  <option timestep="0.01" integrator="RK4"/>
  <worldbody>
    <body pos="0 0 1"><joint name="a" axis="0 1 0" range="-50 50" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size="0.03"/>
      <body pos="0 0 -.4"><joint name="b" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.3" size="0.03"/></body></body>
  </worldbody>
  <actuator><motor joint="b" gear="2"/></actuator>
</mujoco>
"""


def of_limbs(
    model: mujoco.MjModel, worlds: int, timestep: float | None = None
) -> tuple[Dynamics, Entities, Context]:
    """An untrained model of a scene in double precision, states at rest, and the descriptors."""
    layout = read_articulated(model, timestep or natural_step(model))
    config = preset("limbs").model
    torch.manual_seed(0)
    found = Dynamics(layout, config).build(layout.nu).double()
    x, _ = example(layout, worlds)
    q = torch.as_tensor(model.qpos0).expand(worlds, -1)
    rows = torch.as_tensor(limb_rows(model)).expand(worlds, -1, -1)
    world = torch.as_tensor(read_settings(model, layout)).expand(worlds, -1)
    context = Context(torch.zeros(worlds, 0, 0).double(), world, None, rows)
    return found, x._replace(q=q, v=torch.zeros_like(q)), context


def stepped(
    model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """C MuJoCo's states [B, n] after so many timesteps."""
    data, ends = mujoco.MjData(model), []
    for at, fast, control in zip(q, v, u, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = at, fast, control
        mujoco.mj_step(model, data, count)
        ends.append((data.qpos.copy(), data.qvel.copy()))
    return np.array([e[0] for e in ends]), np.array([e[1] for e in ends])
