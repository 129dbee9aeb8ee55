"""Scenes that several tests use."""

from __future__ import annotations

import numpy as np

import orbisim
from orbisim import Scene
from orbisim.backend import Backend
from orbisim.trajectory import Trajectory

PENDULUM = """
<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" range="-2 2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".5"/>
      <body name="hand" pos="0 0 -.4"><geom size=".03" mass=".1"/></body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-1 1" ctrllimited="true"/></actuator>
</mujoco>
"""

EVERYTHING = """
<mujoco model="everything">
  <option timestep="0.002"/>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping=".1"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" density="2000"/>
      <body name="lower" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0" damping=".05"/>
        <site name="wrist" pos=".4 0 0"/>
        <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" density="2000"/>
      </body>
    </body>
    <body name="cube" pos="1 0 1"><freejoint name="cube"/><geom type="box" size=".1 .1 .1"/></body>
    <body name="bob" pos="0 1 1">
      <joint name="socket" type="ball"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
    </body>
    <body name="drawer" pos="0 -1 1">
      <joint name="rail" type="slide" axis="1 0 0" stiffness="20"/><geom size=".05"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder"/>
    <position name="elbow" joint="elbow" kp="5" kv=".5"/>
  </actuator>
  <sensor>
    <jointpos name="encoder" joint="elbow"/>
    <accelerometer name="imu" site="wrist"/>
  </sensor>
</mujoco>
"""

ARM = """
<mujoco model="arm">
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
      <body name="lower" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
        <body name="hand" pos=".4 0 0"><geom size=".04"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def simulate(
    scene: Scene, steps: int, *, seed: int = 0, speed: float = 1.0, backend: Backend | None = None
) -> Trajectory:
    """A rollout from random velocities under a random walk of controls."""
    rng = np.random.default_rng(seed)
    backend = backend or orbisim.make_backend("mujoco", scene)
    state = backend.reset(1)
    state = state.replace(qvel=speed * rng.standard_normal(state.qvel.shape))
    controls = 0.05 * np.cumsum(rng.standard_normal((steps, scene.model.nu)), axis=0)
    return backend.rollout(state, controls)
