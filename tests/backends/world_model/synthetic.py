"""Small packs of episodes, simulated on the spot."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from orbisim_world_model.fitting import robot_parameters
from orbisim_world_model.pack import Pack, hands
from orbisim_world_model.reading import read_attributes, read_layout, read_settings
from orbisim_world_model.reading_parts import encoder_digest, repeated

from orbisim.episodes import random_controls

PENDULUM = """
<mujoco model="swing">
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" gear="3" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""

TABLE = """
<mujoco model="table">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <geom name="table" type="plane" size="2 2 0.1"/>
    <body name="slider" pos="0 0 0.05">
      <joint name="x" type="slide" axis="1 0 0" limited="true" range="-0.5 0.5" damping="5"/>
      <joint name="y" type="slide" axis="0 1 0" limited="true" range="-0.5 0.5" damping="5"/>
      <geom type="cylinder" size="0.03 0.04" mass="0.5"/>
      <site name="tcp"/>
    </body>
    <body name="one" pos="0.15 0 0.04"><freejoint/>
      <geom type="box" size="0.04 0.04 0.04" mass="0.2"/></body>
    <body name="two" pos="-0.1 0.15 0.04"><freejoint/>
      <geom type="box" size="0.03 0.04 0.04" mass="0.1"/></body>
  </worldbody>
  <actuator>
    <position joint="x" kp="100" kv="10" ctrlrange="-0.4 0.4" ctrllimited="true"/>
    <position joint="y" kp="100" kv="10" ctrlrange="-0.4 0.4" ctrllimited="true"/>
  </actuator>
</mujoco>
"""

PUSHER = TABLE.replace("table", "pusher").replace(
    """<site name="tcp"/>""",
    """<geom name="palm" type="box" size="0.03 0.05 0.02" pos="0 0 0.08" mass="0.1"/>
      <site name="tcp" pos="0 0 0.02" euler="0 0 30"/>
      <body name="finger" pos="0.05 0 0">
        <joint name="finger" type="slide" axis="0 1 0" limited="true" range="0 0.04" damping="5"/>
        <geom name="finger" type="box" size="0.01 0.008 0.03" pos="0 0 0.02" mass="0.05"
          friction="0.8 0.005 0.0001"/>
      </body>""",
)
"""The same with a hand of boxes."""

_DOOR = """<body name="frame" pos="0.1 -0.2 0.02" quat="0.9 0 0 0.3">
      <geom type="box" size="0.01 0.02 0.1" pos="0 -0.05 0.1"/>
      <body name="leaf" pos="0.01 0.02 0.1" quat="0.9 0.1 0 0">
        <joint name="hinge" axis="0 0 1" pos="0 -0.02 0" range="-0.2 1.2" damping="0.02"/>
        <geom type="box" size="0.01 0.1 0.08" pos="0 0.08 0" mass="0.3"/>
        <body name="lever" pos="-0.02 0.15 0">
          <joint name="turn" axis="1 0 0" range="-0.8 0.8" stiffness="0.05" damping="0.002"/>
          <geom type="capsule" size="0.01" fromto="0 0 0 -0.02 0.05 0" mass="0.05"/>
        </body>
      </body>
    </body>"""
_BUTTON = """<body name="button" pos="-0.2 -0.1 0.2">
      <joint name="press" type="slide" axis="0 1 1" range="-0.05 0.05" ref="0.01" damping="0.5"/>
      <geom type="cylinder" size="0.02 0.01" mass="0.1"/>
    </body>"""
_ARM = TABLE[: TABLE.index('    <body name="one"')].replace(
    "<option", """<compiler angle="radian"/><option"""
)
_MOTORS = TABLE[TABLE.index("  </worldbody>") :]
DOOR = f"{_ARM}{_DOOR}{_MOTORS}"
"""A hand before a leaf with a lever: two parts, one on the other."""
PANEL = f"{_ARM}{_DOOR}{_BUTTON}{_MOTORS}"
"""The same with a button that slides: three parts."""

BOX = """
<mujoco model="box">
  <option timestep="0.005"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="box" pos="0 0 0.3"><freejoint/>
      <geom type="box" size="0.05 0.05 0.05" mass="0.2"/></body>
  </worldbody>
</mujoco>
"""


def simulate(xml: str, episodes: int, steps: int, substeps: int, seed: int = 0) -> Pack:
    """Episodes from states moved at random, under smooth random controls."""
    model = mujoco.MjModel.from_xml_string(xml)
    timestep = substeps * float(model.opt.timestep)
    layout = read_layout(model, timestep)
    rng = np.random.default_rng(seed)
    controls = random_controls(model, episodes, steps, timestep, seed)
    qpos, qvel, act, ctrl = [], [], [], []
    data = mujoco.MjData(model)
    for episode in range(episodes):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(0.0, 0.5, model.nv)
        for adr in layout.joint_q:
            data.qpos[adr] += rng.uniform(-0.3, 0.3) * (3.0 if all(layout.hinge) else 0.3)
        for t in range(steps + 1):
            qpos.append(data.qpos.copy())
            qvel.append(data.qvel.copy())
            act.append(data.act.copy())
            now = controls[episode, t] if t < steps else np.zeros(model.nu)
            ctrl.append(now)
            data.ctrl[:] = now
            mujoco.mj_step(model, data, substeps)
    state = [torch.tensor(np.array(rows), dtype=torch.float32) for rows in (qpos, qvel, act, ctrl)]
    robot = robot_parameters(model, layout)
    rows, count = steps + 1, len(layout.objects)
    attributes = torch.tensor(read_attributes(model, layout), dtype=torch.float32)
    settings = torch.tensor(read_settings(model, layout), dtype=torch.float32)
    return Pack(
        layout=layout,
        qpos=state[0],
        qvel=state[1],
        act=state[2],
        ctrl=state[3],
        action=state[3],
        hand=hands(layout, state[0], state[1]),
        base=torch.zeros(len(qpos), 0),
        start=torch.arange(episodes) * rows,
        length=torch.full((episodes,), steps),
        attributes=attributes.expand(episodes, count, -1).clone(),
        world=settings.expand(episodes, -1).clone(),
        mask=torch.ones(episodes, count),
        group=torch.zeros(episodes, dtype=torch.long),
        **repeated(model, layout, episodes),
        notes={
            "groups": ["random"],
            "sources": [{"task": "synthetic"}],
            "robot": robot,
            **({"shapes": encoder_digest()} if layout.parts else {}),
        },
    )
