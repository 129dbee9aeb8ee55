"""Episodes of `task:stack` that a policy plays in C MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from cloning import policy as policies
from cloning.eyes import Camera, load_eyes
from cloning.seen import Floats, Seen, flat_yaw, joined, yaw_of
from orbisim.tasks.arm import PANDA, ArmController
from orbisim.tasks.sampling import stream
from orbisim.tasks.stack import Stack
from orbisim.tasks.staging import opening_pose

STEPS = 300
"""Of an episode that a policy plays; demonstrations have 250."""


class Episode:
    """An episode that a policy plays.

    Args:
      source: number of the demonstration that it follows.
    """

    def __init__(self, task: Stack, seed: int, source: int = 0) -> None:
        self.task, self.setting, self.source = task, task.setting("scripted", seed), source
        script = task.script("scripted", self.setting, stream(seed, 1))
        self.arm = ArmController(task.arm)
        qpos, ctrl = opening_pose(script, self.arm)
        self.model = task.scene("scripted", seed).model
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:], self.data.ctrl[:] = qpos, ctrl
        mujoco.mj_forward(self.model, self.data)
        self.grip, self.changes, self.age, self.yaw = -1.0, 0, 0, 0.0
        names = [f"cube{i + 1}" for i in range(len(self.setting.cubes))]
        self.addresses = [int(self.model.joint(name).qposadr[0]) for name in names]
        self.substeps = round(task.control_timestep / self.model.opt.timestep)
        self.path = [self.cubes()]

    def cubes(self) -> Floats:
        """[3, 3], m."""
        return np.stack([self.data.qpos[a : a + 3] for a in self.addresses])

    def seen(self) -> Seen:
        """The present state, N = 1."""
        quat = np.stack([self.data.qpos[a + 3 : a + 7] for a in self.addresses])
        self.yaw = yaw_of(self.arm.rot, around=self.yaw)
        return Seen(
            command=self.arm.pos[None].copy(),
            told=np.array([self.yaw]),
            fingers=self.data.qpos[None, PANDA.joints : PANDA.joints + 2].copy(),
            grip=np.array([self.grip]),
            changes=np.array([self.changes], float),
            age=np.array([self.age], float),
            source=np.array([self.source]),
            cubes=self.cubes()[None],
            yaw=flat_yaw(quat)[None],
        )

    def go(self, place: Floats, yaw: float, close: bool) -> None:
        """One control step towards a place, as far as the arm's longest step goes."""
        turn = yaw - yaw_of(self.arm.rot, around=yaw)
        action = np.array([*(place - self.arm.pos), 0.0, 0.0, turn, 1.0 if close else -1.0])
        changed = self.grip != float(action[6])
        self.grip, self.changes = float(action[6]), self.changes + changed
        self.age = 0 if changed else self.age + 1
        self.data.ctrl[:] = self.arm.step(action)
        mujoco.mj_step(self.model, self.data, self.substeps)
        self.path.append(self.cubes())

    @property
    def success(self) -> bool:
        """The task's own measure."""
        return bool(self.task.success("scripted", self.setting, np.array(self.path)))

    @property
    def stacked(self) -> int:
        """How many cubes rest on the one below: 0, 1 or 2; with `success`, for good."""
        half = self.setting.cubes[0].half
        end, count = self.path[-1], 0
        for below, above in ((0, 1), (1, 2)):
            gap = end[above] - end[below]
            if abs(gap[2] - 2 * half) > 0.005 or np.linalg.norm(gap[:2]) > half:
                break
            count += 1
        return count


def play(
    folder: Path, changes: dict[str, Any], seeds: list[int], noise: float, eyes: Path | None
) -> list[tuple[bool, int, int]]:
    """(success, cubes stacked, demonstration followed) of each episode."""
    torch.set_num_threads(1)
    policy, notes = policies.load(folder)
    task, rng = Stack(**changes), np.random.default_rng(seeds[0] % 2**32)
    shares = np.array(notes["sources"]) / sum(notes["sources"])
    worlds = [Episode(task, seed, int(rng.choice(len(shares), p=shares))) for seed in seeds]
    if eyes is None:
        _play(policy, worlds, lambda seen: seen.blurred(noise, rng))
    else:
        sight = load_eyes(eyes)
        for world in worlds:  # one after another: each has a context of OpenGL
            camera = Camera(world.model)
            _play(
                policy, [world], lambda seen, c=camera, w=world: sight.look(c(w.data)[None], seen)
            )
            camera.close()
    return [(world.success, world.stacked, world.source) for world in worlds]


def _play(policy: policies.Policy, worlds: list[Episode], look: Any) -> None:
    for _ in range(0, STEPS, policies.CHUNK):
        told = policy.told(look(joined([world.seen() for world in worlds])))
        for world, *ahead in zip(worlds, *told, strict=True):
            for place, yaw, close in zip(*ahead, strict=True):
                world.go(place, float(yaw), bool(close))
