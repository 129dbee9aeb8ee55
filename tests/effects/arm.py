"""An arm, a free body, and what forces are on them."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim import Scene, make_backend

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/>
      <geom name="u" type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      <body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 1 0.3"/>
        <geom name="f" type="capsule" fromto="0 0 0 0.25 0 0.1" size="0.02" mass="0.5"/></body>
    </body>
    <body name="ball" pos="2 0 1"><freejoint name="free"/>
      <geom name="ball" type="box" size="0.1 0.05 0.02" mass="0.7"/></body>
  </worldbody>
  <contact><exclude body1="upper" body2="fore"/></contact>
  <actuator>
    <motor name="m1" joint="shoulder" gear="2"/>
    <position name="p2" joint="elbow" kp="5" kv="0.1"/>
  </actuator>
  <sensor><jointpos name="s1" joint="shoulder"/></sensor>
</mujoco>
"""
CTRL = np.array([0.8, -0.45])  # a mild acceleration: frictionloss opposes the velocity
SPEED = np.array([1.5, -2.0, 0.8, 0.3, -0.5, 2.0, -1.0, 3.0])


def start(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    qpos = np.array(model.qpos0)
    qpos[:2] = [0.4, -0.7]
    return qpos, SPEED.copy()


def generalized_force(scene: Scene, time: float = 0.0, backend: str = "mujoco") -> np.ndarray:
    """M(q) a + bias from one very short step: all forces but gravity and Coriolis."""
    engine = make_backend(backend, scene)
    engine.report = {"qacc"}
    qpos, qvel = start(scene.model)
    state = engine.reset().replace(qpos=qpos[None], qvel=qvel[None], time=np.array([time]))
    after = engine.step(state, CTRL)
    data = mujoco.MjData(scene.model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(scene.model, data)
    full = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, full)
    return full @ after.memory["qacc"][0] + data.qfrc_bias


def velocities(model: mujoco.MjModel, body: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angular and linear velocity of the centre of mass in the world, and its Jacobian."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start(model)
    mujoco.mj_forward(model, data)
    jacp, jacr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacp, jacr, model.body(body).id)
    return jacr @ data.qvel, jacp @ data.qvel, jacp
