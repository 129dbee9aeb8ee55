"""A small task whose best policy is known: to go to a place at a speed that is chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from orbisim_policies.problem import Floats, Moment, Problem, Starts
from torch import Tensor

from orbisim.scene import Scene, load_scene

_XML = """
<mujoco model="slide">
  <option timestep="0.05" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="slider">
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><velocity name="drive" joint="x" kv="100" ctrlrange="-2 2"/></actuator>
</mujoco>
"""


class Slide(Problem):
    """Ten steps of 50 ms at up to 2 m/s; the goal is up to 0.5 m away, either way.

    Going there at once and staying is worth about 0.85 of a reward in the mean, standing still
    0.27, of 1 - 3 |x - goal| and nothing beyond 0.33 m.
    """

    name, timestep, steps = "test:slide", 0.05, 10
    actions, observations, parts, sparse = 1, 3, ("reward",), False

    def __init__(self) -> None:
        self.scene: Scene = load_scene(_XML)

    def draw(self, seeds: Sequence[int]) -> Starts:
        goals = [np.random.default_rng(seed).uniform(-0.5, 0.5) for seed in seeds]
        still = np.zeros((len(goals), 1))
        return Starts(still, still, still, np.array(goals)[:, None], np.zeros((len(goals), 0)))

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        return torch.cat([torch.zeros_like(qpos), command.to(qpos)], 1)

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        reward = (1.0 - 3.0 * (qpos - score[:, 1:]).abs()).clamp_min(0.0) / self.steps
        return torch.cat([score[:, :1] + reward, score[:, 1:]], 1)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        return score[:, :1]

    def observe(self, moment: Moment) -> Tensor:
        away = moment.command.to(moment.qpos) - moment.qpos
        return torch.cat([away, moment.qvel, moment.time[:, None]], 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        return 2.0 * action.clamp(-1.0, 1.0), command

    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        return {"near": np.abs(qpos - starts.command)[:, 0] < 0.05}
