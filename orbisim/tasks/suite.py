"""`suite:<domain>-<task>`: episodes of dm_control's suite."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim import suite
from orbisim.episodes import Episodes
from orbisim.errors import InputError
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.tasks.base import Scripted, Task
from orbisim.tasks.episode import Episode, Rollout, check_stable, clock
from orbisim.tasks.sampling import stream
from orbisim.tasks.suite_feedback import feedback, has_feedback
from orbisim.tasks.suite_policies import Policy, held, noisy, reach, rhythm, smooth
from orbisim.tasks.suite_states import spread_out
from orbisim.tasks.views import Cast, make_episode, moving_bodies

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SuiteConfig:
    """How episodes of the suite are made.

    Attributes:
      steps: control steps of an episode.
      spread: share of the episodes that start from anywhere in the range of the joints, instead of
        where the task starts.
      noise: largest size of the noise on feedback policies, as a share of the control range.
      substeps: states that are kept of each control step; the control is held over all of them, and
        a control step of the data is the task's divided by it.
    """

    steps: int = 250
    spread: float = 0.6
    noise: float = 0.4
    substeps: int = 1


class SuiteTask(Task):
    """A domain of the suite under a mixture of noise, rhythms and feedback.

    Args:
      task: `domain-task`.
      **changes: to `SuiteConfig`.

    Raises:
      UnknownNameError: there is no such task.
    """

    name: ClassVar[str] = "suite"
    counts: ClassVar[Mapping[str, int]] = {
        "held": 200,
        "smooth": 300,
        "rhythm": 150,
        "reach": 150,
        "feedback": 400,
    }
    default_subtask = "smooth"
    config: SuiteConfig = SuiteConfig()

    def __init__(self, task: str, **changes: Any) -> None:
        super().__init__(**changes)
        self.domain, self.task = suite.split_name(task)
        model, self._held = _nominal(self.domain, self.task)
        self._controlled = model.nu > 0
        self.control_timestep = self._held / self.config.substeps
        self.horizon = self.config.steps * self._held
        _check_substeps(self.label, self.control_timestep / model.opt.timestep)

    @property
    def subtasks(self) -> Mapping[str, int]:
        """How many episodes of each policy; without feedback where the domain has none."""
        usable = has_feedback(self.domain) and self._controlled
        return {k: v for k, v in self.counts.items() if usable or k != "feedback"}

    @property
    def label(self) -> str:
        """The name as `load_scene` and `orbisim collect` take it."""
        return f"suite:{self.domain}-{self.task}"

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """The task's scene as its episode of that seed has it."""
        self.check_subtask(subtask)
        physics, _ = start(self.domain, self.task, 0 if seed is None else seed)
        return Scene.from_model(physics.model.ptr, source=self.label)

    def episode(self, subtask: str, seed: int) -> Episode:
        """One episode."""
        physics, _ = start(self.domain, self.task, seed)
        model = physics.model.ptr
        scene = Scene.from_model(model, source=self.label)
        return make_episode(
            model,
            Cast(moving_bodies(model)),
            self._run(physics, subtask, seed),
            subtask=subtask,
            seed=seed,
            scene_hash=scene.fingerprint,
            control_timestep=self.control_timestep,
        )

    def trials(self, count: int, seed: int, subtask: str | None = None) -> Episodes:
        """Episodes with the controls of a policy, on the model of the first one's task."""
        name = self.check_subtask(subtask)
        physics, _ = start(self.domain, self.task, seed)
        scene = Scene.from_model(physics.model.ptr, source=self.label)
        runs = [self._run(physics, name, seed + i) for i in range(count)]
        qpos, qvel, act = (
            np.stack([getattr(run, name)[0] for run in runs]) for name in ("qpos", "qvel", "act")
        )
        initial = State(np.zeros(count), qpos, qvel, act)
        sequence = np.stack([run.ctrl for run in runs])
        return Scripted(scene, initial, sequence, self.control_timestep)

    def policy(self, subtask: str, model: mujoco.MjModel, rng: np.random.Generator) -> Policy:
        """The policy of a subtask; randomised by `rng`."""
        step = self._held
        if subtask == "feedback":
            size = rng.uniform(0, self.config.noise) * float(rng.random() < 0.7)
            return noisy(feedback(self.domain, model, step), model, rng, size)
        makers = {"held": held, "smooth": smooth, "rhythm": rhythm, "reach": reach}
        return makers[subtask](model, rng, step)

    def _run(self, physics: Any, subtask: str, seed: int) -> Rollout:
        model, rng = physics.model.ptr, stream(seed, 1)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = physics.data.qpos, physics.data.qvel
        if rng.random() < self.config.spread:
            spread_out(model, data, rng)
        policy = self.policy(subtask, model, rng)
        steps, substeps = self.config.steps, self.config.substeps
        return simulate(model, data, policy, steps, self._held, substeps)


def _check_substeps(label: str, ratio: float) -> None:
    if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
        raise InputError(
            f"{label}: a control step in so many parts has {ratio:g} timesteps in each; expected a "
            "whole number"
        )


def simulate(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    policy: Policy,
    steps: int,
    control_timestep: float,
    substeps: int = 1,
    step: Callable[..., Any] = mujoco.mj_step,
) -> Rollout:
    """Runs a policy from the state in `data`; its clock restarts at 0.

    Args:
      steps: controls that the policy gives, each held for `control_timestep` seconds.
      substeps: states that are kept of each.
      step: called like `mujoco.mj_step`.
    """
    data.time = 0.0
    timesteps = round(control_timestep / substeps / model.opt.timestep)
    states = [(data.qpos.copy(), data.qvel.copy(), data.act.copy())]
    ctrl = np.empty((steps, model.nu))
    for t in range(steps):
        ctrl[t] = data.ctrl[:] = policy(data)
        for _ in range(substeps):
            step(model, data, timesteps)
            states.append((data.qpos.copy(), data.qvel.copy(), data.act.copy()))
    check_stable(data)
    qpos, qvel, act = (np.array(part) for part in zip(*states, strict=True))
    time = clock(steps * substeps, control_timestep / substeps)
    ctrl = np.repeat(ctrl, substeps, axis=0)
    return Rollout(time, qpos, qvel, act, ctrl, ctrl)


def start(domain: str, task: str, seed: int) -> tuple[Any, float]:
    """The physics of a task after its own initialisation, and its control timestep, s."""
    environment = _environment(domain, task)
    environment.task._random = np.random.RandomState(seed % 2**32)
    environment.reset()
    return environment.physics, environment.control_timestep()


@functools.cache
def _environment(domain: str, task: str) -> Any:
    """One for each process; a reset draws anew whatever an episode's task changes in the model."""
    from dm_control import suite as dm_suite

    return dm_suite.load(domain, task, task_kwargs={"random": 0})


@functools.cache
def _nominal(domain: str, task: str) -> tuple[mujoco.MjModel, float]:
    physics, control_timestep = start(domain, task, 0)
    return physics.model.ptr, control_timestep
