"""Small scenes that the conformance tests run on."""

from __future__ import annotations

PENDULUM = """
<mujoco model="pendulum">
  <option timestep="0.002" integrator="RK4"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A frictionless pendulum: energy is conserved."""

CARTPOLE = """
<mujoco model="cartpole">
  <option timestep="0.005"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.1" limited="true" range="-2 2"/>
      <geom type="box" size="0.1 0.05 0.05" mass="1"/>
      <body name="pole">
        <joint name="hinge" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="slide" gear="5" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
  <sensor><jointpos name="x" joint="slide"/><jointvel name="w" joint="hinge"/></sensor>
</mujoco>
"""
"""Slide, hinge, motor, limits and sensors."""

FILTERED = """
<mujoco model="filtered">
  <option timestep="0.004"/>
  <worldbody>
    <body name="arm">
      <joint name="elbow" axis="0 1 0" damping="0.2" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator>
    <general name="servo" joint="elbow" dyntype="filter" dynprm="0.05" gainprm="4" biastype="affine"
      biasprm="0 -4 -0.1"/>
  </actuator>
</mujoco>
"""
"""An actuator with activation state."""

FREE_BODY = """
<mujoco model="free_body">
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="brick" pos="0 0 1">
      <freejoint name="free"/>
      <geom type="box" size="0.1 0.2 0.3" mass="2"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A rigid body in empty space: momentum is conserved."""

RESTING_BOX = """
<mujoco model="resting_box">
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="box" pos="0 0 0.1">
      <freejoint name="free"/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A box on the floor: it stays there, and the floor carries its weight."""

CLOTH = """
<mujoco model="cloth">
  <option timestep="0.002" integrator="implicitfast" solver="CG" tolerance="1e-6"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <geom name="ball" size="0.1" pos="0.02 0 0.1"/>
    <flexcomp name="cloth" type="grid" count="4 4 1" spacing="0.08 0.08 0.08" dim="2"
      radius="0.006" mass="0.02" pos="0 0 0.25">
      <contact solref="0.008 1" selfcollide="none"/>
      <edge equality="true" solref="0.01 1" damping="0.01"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""
"""A flex of free vertices above a ball on the floor."""

COLOURS = """
<mujoco model="colours">
  <visual><headlight ambient="0.6 0.6 0.6" diffuse="0.4 0.4 0.4" specular="0 0 0"/></visual>
  <worldbody>
    <camera name="front" pos="0 -2 0" xyaxes="1 0 0 0 0 1" fovy="45"/>
    <camera name="above" pos="0 0 2" fovy="45"/>
    <body name="ball">
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom name="ball" type="sphere" size="0.3" rgba="1 0 0 1" mass="1"/>
    </body>
    <geom name="wall" type="box" size="2 0.1 2" pos="0 1.1 0" rgba="0 0 1 1"/>
  </worldbody>
</mujoco>
"""
"""A red ball 2 m in front of a camera; the blue wall behind it starts at 3 m."""

RUNGE_KUTTA = CARTPOLE.replace('timestep="0.005"', 'timestep="0.005" integrator="RK4"')
"""Cart and pole, integrated by Runge-Kutta."""

DIVERGING = (
    'gainprm="1e30"',
    'gainprm="1e12"',
    'damping="-1e6"',
    'stiffness="-1e9"',
)
"""What makes a motor on a hinge diverge in C MuJoCo within 20 steps."""


def diverging(attributes: str) -> str:
    """An arm that diverges: attributes of its motor, its joint or the integration."""
    marks = dict.fromkeys(("gainprm", "integrator", "joint"), "")
    for attribute in attributes.split():
        name = attribute.partition("=")[0]
        marks[name if name in marks else "joint"] += attribute
    return f"""
<mujoco model="diverging">
  <option {marks["integrator"]}/>
  <worldbody>
    <body><joint name="hinge" axis="0 1 0" ref="5" {marks["joint"]}/>
      <geom size="0.1" pos="0.3 0 0"/></body>
  </worldbody>
  <actuator><general joint="hinge" {marks["gainprm"]}/></actuator>
</mujoco>
"""
