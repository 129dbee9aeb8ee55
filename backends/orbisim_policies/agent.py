"""A policy that acts, in any backend, one control step after the other."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import torch

from orbisim.backend import Backend
from orbisim.compare import join
from orbisim.episodes import Episodes
from orbisim.errors import InputError
from orbisim.scene import load_scene
from orbisim.state import State
from orbisim.trajectory import Trajectory
from orbisim_policies.checkpoint import AnyPolicy, check_scene, load_policy, read_manifest
from orbisim_policies.evaluate import as_float
from orbisim_policies.problem import Moment, Problem, Starts
from orbisim_policies.problems import make_problem
from orbisim_policies.zoo import resolved


@dataclasses.dataclass
class Agent:
    """A policy and what it is for.

    Attributes:
      policy: from observations to actions. problem: on the CPU.
      starts: of the episodes that were made last.
      nominal: whether it sees nominal values of what no image shows, as policies that were trained
        from films do.
    """

    policy: AnyPolicy
    problem: Problem
    starts: Starts | None = None
    nominal: bool = False

    @staticmethod
    def of(folder: Path, scene: str) -> Agent:
        """Reads a policy for a scene.

        Raises:
          InputError: it is damaged, or for another scene.
          SceneError: the scene cannot be read.
        """
        folder = resolved(folder)
        manifest = read_manifest(folder)
        check_scene(folder, str(manifest.get("scene_hash", "")), load_scene(scene))
        problem = make_problem(str(manifest.get("task")), int(manifest.get("steps", 0)) or None)
        return Agent(load_policy(folder, problem), problem, nominal="films" in manifest)

    def episodes(self, count: int, seed: int) -> Episodes:
        """Episodes of the policy's problem on one scene."""
        scene, self.starts = self.problem.trials(count, seed)
        starts = self.starts
        act = np.zeros((count, scene.model.na))
        return Episodes(scene, State(np.zeros(count), starts.qpos, starts.qvel, act))

    def act(self, engine: Backend, episodes: Episodes, duration: float) -> Trajectory:
        """Simulates for some seconds, and at least one control step.

        Raises:
          InputError: the backend's step does not divide the control step.
        """
        problem, starts = self.problem, self.starts
        assert starts is not None
        ratio = problem.timestep / engine.timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            raise InputError(
                f"backend {engine.name!r} takes steps of {engine.timestep:g} s; the policy acts "
                f"every {problem.timestep:g} s, which must be a multiple of them"
            )
        state = episodes.initial
        command, params = as_float(starts.command), as_float(starts.params)
        params = problem.unseen(params) if self.nominal else params
        score = problem.begin(as_float(state.qpos), as_float(state.qvel), command)
        pieces, controls, policy = [], [], self.policy.begin(len(score))
        for step in range(max(1, round(duration / problem.timestep))):
            qpos, qvel = as_float(state.qpos), as_float(state.qvel)
            time = torch.full((len(qpos),), min(step / problem.steps, 1.0))
            with torch.no_grad():
                view = problem.observe(Moment(qpos, qvel, command, params, score, time))
                control, command = problem.control(command, policy(view))
            held = np.repeat(control.double().numpy()[:, None], round(ratio), axis=1)
            pieces.append(engine.rollout(state, held))
            controls.append(held)
            state = pieces[-1].final
            if step < problem.steps:
                score = problem.count(score, as_float(state.qpos), as_float(state.qvel), control)
        self._score = score
        return join(episodes.initial, np.concatenate(controls, axis=1), pieces)

    def result(self, trajectory: Trajectory) -> dict[str, Any]:
        """What came of the episodes: rewards, and share of successes by definition."""
        assert self.starts is not None
        qpos = np.asarray(trajectory.final.qpos)
        value = self.problem.measure(self._score, as_float(qpos)).double().numpy()
        found = self.problem.success(self.starts, qpos, value)
        shares = {f"success_{name}": float(np.mean(row)) for name, row in found.items()}
        means = zip(self.problem.parts, value.mean(axis=0).tolist(), strict=True)
        return {**shares, **dict(means)}
