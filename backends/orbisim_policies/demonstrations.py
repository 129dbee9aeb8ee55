"""Demonstrations: the task's scripted policy, which knows where it wants to push."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbisim.tasks.motion import Director
from orbisim_policies.problem import Floats
from orbisim_policies.push import REACH, TURN, PushProblem
from orbisim_policies.true import TrueWorlds

SLOWEST = 0.3
"""m/s: slower pushes of `task:push` do not end within an episode of 64 steps."""
_AT_ONCE = 256  # worlds side by side: more make no thread busier and take memory


@dataclasses.dataclass(frozen=True)
class Demonstrations:
    """What the script did.

    Attributes:
      observations: [M, F]. actions: [M, A], of all steps of all episodes.
      success: share of the episodes whose second cube moved more than 5 cm.
      episodes, steps: how many, in MuJoCo.
    """

    observations: Tensor
    actions: Tensor
    success: float
    episodes: int
    steps: int


class Commander:
    """What a `Director` needs of an arm; its actions are a policy's.

    Attributes:
      pos: commanded position [3], m. yaw: commanded turn, rad.
    """

    def __init__(self, pos: Floats, yaw: float) -> None:
        self.pos, self.yaw = np.array(pos), yaw

    def action_to(self, pos: Floats, rot: Floats, gripper: float) -> Floats:
        """The action [4] that goes towards a pose, as far as one step goes."""
        way, turn = pos - self.pos, float(np.arctan2(rot[1, 0], rot[0, 0])) - self.yaw
        length = float(np.linalg.norm(way))
        way = way * min(1.0, REACH / max(length, 1e-12))
        turn = float(np.clip(turn, -TURN, TURN))
        self.pos, self.yaw = self.pos + way, self.yaw + turn
        return np.append(way / REACH, turn / TURN)


def demonstrate(problem: PushProblem, seeds: Sequence[int], nthread: int = 0) -> Demonstrations:
    """Runs the script of `task:push` in the problem's episodes, in MuJoCo."""
    seen, done, wins, steps = [], [], [], 0
    for first in range(0, len(seeds), _AT_ONCE):
        part = seeds[first : first + _AT_ONCE]
        starts = problem.draw(part)
        directors = [director(problem, seed) for seed in part]
        with contextlib.closing(TrueWorlds(problem, len(part), nthread)) as worlds:
            worlds.begin(np.arange(len(part)), starts)
            views, actions, lost = [], [], np.zeros(len(part), bool)
            for _ in range(problem.steps):
                action = torch.as_tensor(np.array([d.action() for d in directors])).float()
                views.append(worlds.observation())
                actions.append(action)
                lost |= worlds.step(action)
            steps += worlds.steps
            value = worlds.worth().double().numpy()
            success = problem.success(starts, worlds.coordinates[0], value)
        wins.append(success["moved"] & ~lost)
        kept = torch.as_tensor(~lost)
        seen.append(torch.stack(views)[:, kept].flatten(0, 1))
        done.append(torch.stack(actions)[:, kept].flatten(0, 1))
    share = float(np.concatenate(wins).mean())
    return Demonstrations(torch.cat(seen), torch.cat(done), share, len(seeds), steps)


def director(problem: PushProblem, seed: int) -> Director:
    """The script of the episode of a seed; its actions are a policy's."""
    layout = problem.layout(seed)
    stroke = dataclasses.replace(layout.stroke, speed=max(layout.stroke.speed, SLOWEST))
    arm: Any = Commander(np.array(layout.tool), 0.0)
    return Director(stroke.segments(), arm, 0.0, problem.timestep)
