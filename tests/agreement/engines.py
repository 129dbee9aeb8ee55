"""Engines with faults of their own, and scenes that show them."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from orbisim import Backend, Capability, Scene, State, make_backend

STAND = """
<mujoco model="stand">
  <worldbody>
    <geom name="stand" type="cylinder" size=".06 .1" pos="0 0 .1"/>
    <body name="base" pos="0 0 .2"><joint name="yaw" axis="0 0 1" damping=".1"/>
      <geom name="base" type="capsule" fromto="0 0 0 0 0 .2" size=".03"/>
      <body name="arm" pos="0 0 .2"><joint name="shoulder" axis="0 1 0" damping=".1"/>
        <geom name="arm" type="capsule" fromto="0 0 0 .3 0 0" size=".03"/></body></body>
  </worldbody>
</mujoco>
"""
"""An arm whose base link stands 3 cm inside its stand: MuJoCo-Warp does not move it."""

FALLING = """
<mujoco model="falling">
  <worldbody>
    <geom name="floor" type="plane" size="2 2 .1"/>
    <body name="box" pos="0 0 .099"><freejoint name="free"/>
      <geom name="box" type="box" size=".1 .1 .1"/></body>
    <body name="pendulum" pos="1 0 1"><joint name="hinge" axis="0 1 0"/>
      <geom name="bob" type="capsule" fromto="0 0 0 .3 0 0" size=".03"/></body>
  </worldbody>
</mujoco>
"""
"""A box that rests on the floor beside a pendulum that swings."""


class Faulty(Backend):
    """C MuJoCo under another name; subclasses do something wrong."""

    name = "faulty"
    capabilities = frozenset({Capability.CLASSICAL})

    def load(self, scene: Scene) -> None:
        self._scene = scene
        self._engine = make_backend("mujoco", self.wrong(scene))

    def wrong(self, scene: Scene) -> Scene:
        return scene

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        return self._engine.reset(self.check_reset(nworld, seed))

    def step(self, state: State, control: Any = None, nstep: int = 1) -> State:
        control, nstep = self.check_step(state, control, nstep)
        return self._engine.step(state, control, nstep)


class Frozen(Faulty):
    """Time runs, nothing moves."""

    def step(self, state: State, control: Any = None, nstep: int = 1) -> State:
        return state.replace(time=state.time + nstep * self.timestep)


class Blind(Faulty):
    """Sees no contacts."""

    def wrong(self, scene: Scene) -> Scene:
        model = copy.copy(scene.model)
        model.geom_contype[:] = model.geom_conaffinity[:] = 0
        return scene.with_model(model)


class Rounded(Faulty):
    """Right, in single precision."""

    def step(self, state: State, control: Any = None, nstep: int = 1) -> State:
        after = super().step(state, control, nstep)
        return after.replace(
            qpos=after.qpos.astype(np.float32).astype(float),
            qvel=after.qvel.astype(np.float32).astype(float),
        )


class Reckless(Faulty):
    """Goes on where C MuJoCo diverges."""

    def wrong(self, scene: Scene) -> Scene:
        model = copy.copy(scene.model)
        model.actuator_gainprm[:, 0] = 1.0
        return scene.with_model(model)


def loaded(cls: type[Faulty], scene: Scene, nworld: int = 1) -> Faulty:
    """An engine with a scene."""
    engine = cls(nworld=nworld)
    engine.load(scene)
    return engine
