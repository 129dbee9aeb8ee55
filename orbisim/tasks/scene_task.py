"""Episodes of any scene: a path in place of a task's name, an augmented scene above all."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np

from orbisim.effects.plain import Step
from orbisim.episodes import Episodes
from orbisim.errors import InputError
from orbisim.scene import Scene, load_scene
from orbisim.scene.hidden import hidden_joints
from orbisim.scene.texts import check_texts
from orbisim.state import State
from orbisim.tasks.base import Scripted, Task
from orbisim.tasks.episode import Episode, Rollout
from orbisim.tasks.randomize import Factors, checked, drawn
from orbisim.tasks.sampling import stream
from orbisim.tasks.suite import simulate
from orbisim.tasks.suite_policies import Policy, held, reach, rhythm, smooth
from orbisim.tasks.suite_states import spread_out
from orbisim.tasks.views import Cast, make_episode, moving_bodies

_STEP = 0.02
"""About how long a control is held, s: 50 Hz, as in most of dm_control's suite."""
_SPIN = 4.0
"""Of bodies that are let go, rad/s; and their speed is a quarter of it, m/s."""


@dataclasses.dataclass(frozen=True)
class SceneConfig:
    """How episodes of a scene are made.

    Attributes:
      steps: control steps of an episode.
      control_timestep: s; the nearest whole number of timesteps counts.
      spread: share of the episodes that start from anywhere in the range of the joints, instead of
        the scene's reference configuration.
    """

    steps: int = 250
    control_timestep: float = _STEP
    spread: float = 0.6


class SceneTask(Task):
    """A scene from a file under noise, rhythms and reaching; let go if nothing drives it.

    What the scene carries of effects acts, as under the backend `mujoco`.

    Args:
      path: of the scene.
      randomize: factors by which each episode's model may differ (see `orbisim.tasks.randomize`).
      **changes: to `SceneConfig`.

    Raises:
      SceneError: it cannot be read.
      InputError: it carries a learned residual force, or nothing in it moves.
    """

    name: ClassVar[str] = "scene"
    counts: ClassVar[Mapping[str, int]] = {"held": 200, "smooth": 300, "rhythm": 150, "reach": 150}
    config: SceneConfig = SceneConfig()

    def __init__(self, path: str, randomize: Factors | None = None, **changes: Any) -> None:
        super().__init__(**changes)
        self._path, self._scene = path, load_scene(path)
        self._factors = checked(randomize) if randomize else {}
        model = self._scene.model
        drawn(model, self._factors, stream(0, 0))
        if not model.nv:
            raise InputError(f"{path}: nothing in the scene moves")
        check_texts(model, path)
        _stepper(model)
        timesteps = max(1, round(self.config.control_timestep / model.opt.timestep))
        self.control_timestep = timesteps * float(model.opt.timestep)
        self.horizon = self.config.steps * self.control_timestep
        self.default_subtask = next(iter(self.subtasks))

    @property
    def subtasks(self) -> Mapping[str, int]:
        """How many episodes of each policy."""
        model = self._scene.model
        joint = int(mujoco.mjtTrn.mjTRN_JOINT)
        reaches = model.nu == model.nactuator and (model.actuator_trntype == joint).all()
        known = {k: v for k, v in self.counts.items() if reaches or k != "reach"}
        return known if model.nu else {"free": 800}

    @property
    def label(self) -> str:
        """The path, as it was given."""
        return self._path

    @property
    def identity(self) -> str:
        """Of the scene in the file."""
        return self._scene.fingerprint

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """The scene; with a seed, the one that is drawn for it."""
        self.check_subtask(subtask)
        if seed is None or not self._factors:
            return self._scene
        return self._scene.with_model(drawn(self._scene.model, self._factors, stream(seed, 0)))

    def episode(self, subtask: str, seed: int) -> Episode:
        """One episode."""
        scene = self.scene(subtask, seed)
        return make_episode(
            scene.model,
            Cast(moving_bodies(scene.model)),
            self._run(scene.model, subtask, seed),
            subtask=subtask,
            seed=seed,
            scene_hash=scene.fingerprint,
            control_timestep=self.control_timestep,
        )

    def trials(self, count: int, seed: int, subtask: str | None = None) -> Episodes:
        """Episodes of the scene as declared, with the controls of a policy."""
        model, name = self._scene.model, self.check_subtask(subtask)
        runs = [self._run(model, name, seed + i) for i in range(count)]
        qpos, qvel, act = (
            np.stack([getattr(run, name)[0] for run in runs]) for name in ("qpos", "qvel", "act")
        )
        initial = State(np.zeros(count), qpos, qvel, act)
        sequence = np.stack([run.ctrl for run in runs])
        return Scripted(self._scene, initial, sequence, self.control_timestep)

    def _run(self, model: mujoco.MjModel, subtask: str, seed: int) -> Rollout:
        rng = stream(seed, 1)
        data = mujoco.MjData(model)
        if rng.random() < self.config.spread:
            _spread(model, data, rng)
        if subtask == "free":
            _let_go(model, data, rng)
        policy = self._policy(subtask, model, rng)
        step = _stepper(model)
        return simulate(model, data, policy, self.config.steps, self.control_timestep, step=step)

    def _policy(self, subtask: str, model: mujoco.MjModel, rng: np.random.Generator) -> Policy:
        if subtask == "free":
            return lambda data: np.zeros(0)
        makers = {"held": held, "smooth": smooth, "rhythm": rhythm, "reach": reach}
        return makers[subtask](model, rng, self.control_timestep)


def _stepper(model: mujoco.MjModel) -> Step:
    try:
        return Step(model)
    except NotImplementedError as error:
        raise InputError(f"episodes cannot be collected: {error}") from None


def _spread(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """Anywhere in the range; joints that effects have added stay where they rest."""
    spread_out(model, data, rng)
    for name in hidden_joints(model):
        joint = model.joint(name)
        data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]] = model.qpos0[joint.qposadr[0]], 0.0


def _let_go(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """Random velocities of free bodies; they start where the scene has them."""
    for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        dof = int(model.jnt_dofadr[joint])
        data.qvel[dof : dof + 3] += _SPIN / 4 * rng.standard_normal(3)
        data.qvel[dof + 3 : dof + 6] += _SPIN * rng.standard_normal(3)
