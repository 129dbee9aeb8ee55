"""A physics and tasks as a user writes them, to be run in many worlds."""

from __future__ import annotations

import collections
from typing import Any

import numpy as np
from dm_control import mujoco
from dm_control.rl import control
from dm_control.suite import base

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="ball" pos="0 0 .5">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="ball" type="sphere" size=".1" mass="1"/>
    </body>
    <site name="target" size=".05" pos="1 0 .3"/>
  </worldbody>
  <actuator><motor name="push" joint="x" gear="10" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


class Ball(mujoco.Physics):
    """A ball that is pushed along a line."""

    def to_target(self) -> Any:
        return self.named.data.site_xpos["target"] - self.named.data.geom_xpos["ball"]


class Reach(base.Task):
    """Push the ball to a target that is elsewhere in each episode; it ends 1 m to the left."""

    def initialize_episode(self, physics: Any) -> None:
        physics.named.data.qpos["x"] = self.random.uniform(-0.2, 0.2)
        physics.named.model.site_pos["target", "x"] = self.random.uniform(-1, 1)
        physics.named.model.body_mass["ball"] = self.random.uniform(0.5, 2.0)
        self.far = self.random.uniform(1.0, 2.0)
        super().initialize_episode(physics)

    def get_observation(self, physics: Any) -> Any:
        found = collections.OrderedDict()
        found["to_target"] = physics.to_target()
        found["speed"] = physics.named.data.qvel["x"][0]
        found["is_low"] = physics.named.data.xpos["ball", "z"] < 0.3
        return found

    def get_reward(self, physics: Any) -> Any:
        distance = np.linalg.norm(physics.to_target())
        if distance > self.far:
            return -1.0
        return max(0.0, 1.0 - distance)

    def get_termination(self, physics: Any) -> Any:
        position = physics.named.data.qpos["x"][0]
        if position < -1.0:
            return 0.0
        return 0.5 if position > 1.0 else None


class Counting(Reach):
    """Keeps something when it is asked for a reward: cannot be run for all worlds at once."""

    calls = 0

    def get_reward(self, physics: Any) -> Any:
        self.calls += 1
        return super().get_reward(physics) + self.calls


class Drawing(Reach):
    """Observes with noise."""

    def get_observation(self, physics: Any) -> Any:
        found = super().get_observation(physics)
        found["speed"] = found["speed"] + self.random.normal()
        return found


class Wind(Reach):
    """Acts on the physics before and after each step."""

    def before_step(self, action: Any, physics: Any) -> None:
        super().before_step(action, physics)
        physics.named.data.xfrc_applied["ball", 0] = self.random.normal()

    def after_step(self, physics: Any) -> None:
        self.height = float(physics.named.data.xpos["ball", "z"])

    def get_reward(self, physics: Any) -> Any:
        return super().get_reward(physics) + self.height


class Fixed(Reach):
    """Draws when it is made, so that worlds differ from the beginning."""

    def __init__(self, random: Any) -> None:
        super().__init__(random=random)
        self.bonus = self.random.uniform()

    def get_reward(self, physics: Any) -> Any:
        return super().get_reward(physics) + self.bonus


def environment(task: type[Reach] = Reach, time_limit: float = 0.5, **kwargs: Any) -> Any:
    """Makes environments by their seed."""

    def make(seed: int) -> control.Environment:
        physics = Ball.from_xml_string(XML)
        made = task(random=seed)
        return control.Environment(physics, made, time_limit=time_limit, n_sub_steps=2, **kwargs)

    return make
