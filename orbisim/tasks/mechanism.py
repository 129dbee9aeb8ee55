"""`task:mechanism:<family>`: a Panda operates a mechanism on a table."""

from __future__ import annotations

import dataclasses
import functools
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from orbisim.effects import EffectInstance
from orbisim.effects.carry import write_carried
from orbisim.scene import Scene
from orbisim.scene.files import embed
from orbisim.scene.urdf import read_urdf
from orbisim.state import State
from orbisim.tasks import assets
from orbisim.tasks.arm import PANDA, pointing_down
from orbisim.tasks.armtask import controller
from orbisim.tasks.base import Scripted, Task
from orbisim.tasks.episode import Episode, Rollout
from orbisim.tasks.mechanisms.catalogue import HELD_OUT, INSTANCES, make
from orbisim.tasks.mechanisms.model import BASE, Mechanism
from orbisim.tasks.mechanisms.operating import Manner, Operator
from orbisim.tasks.mechanisms.urdf import write_urdf
from orbisim.tasks.motion import OPEN
from orbisim.tasks.sampling import Range, stream
from orbisim.tasks.staging import Script, perform
from orbisim.tasks.views import Cast, make_episode

_ARM = dataclasses.replace(PANDA, posture=(0.0, 0.0, 0.3, 0.0, 0.1, 0.0, 0.0))
_START = (0.36, 0.0, 0.42)
"""Where the tool begins, m."""
EPISODES = 20
"""Of each instance, as in the paper."""


@dataclasses.dataclass(frozen=True)
class MechanismConfig:
    """What an episode is drawn from.

    Attributes:
      instance: its number; -1 for one drawn from the subtask's.
      shift: of the base from its nominal place, along x and along y, m.
      turn: of the base about the vertical, rad.
      speed: of the hand, m/s. turning: of the hand, rad/s.
      slip: how far beside where it should the hand takes hold, m.
      release: share of the episodes in which the hand releases what is locked before it pulls.
    """

    instance: int = -1
    shift: Range = (-0.05, 0.05)
    turn: Range = (-np.pi / 18, np.pi / 18)
    speed: Range = (0.25, 0.35)
    turning: Range = (0.8, 1.1)
    slip: Range = (-0.002, 0.002)
    release: float = 1.0


class MechanismTask(Task):
    """A family of mechanisms.

    Subtasks: `train` (instances to learn from) and `held_out` (others of the family).

    Args:
      family: which, as `door`.
      **changes: fields of the configuration to replace.
    """

    name: ClassVar[str] = "mechanism"
    counts: ClassVar[Mapping[str, int]] = {
        "train": EPISODES * (INSTANCES - HELD_OUT),
        "held_out": EPISODES * HELD_OUT,
    }
    default_subtask = "train"
    control_timestep = 0.05
    steps = 301
    horizon = steps * control_timestep
    config: MechanismConfig = MechanismConfig()

    def __init__(self, family: str, **changes: Any) -> None:
        super().__init__(**changes)
        self.family = family

    @property
    def label(self) -> str:
        """The name as `load_scene` and `orbisim collect` take it."""
        return f"task:{self.name}:{self.family}"

    def instance(self, subtask: str | None, seed: int | None) -> Mechanism:
        """The mechanism of an episode; the first one without a seed."""
        name = self.check_subtask(subtask)
        if self.config.instance >= 0:
            return make(self.family, self.config.instance)
        trained = INSTANCES - HELD_OUT
        low, high = (0, trained) if name == "train" else (trained, INSTANCES)
        return make(self.family, low if seed is None else int(stream(seed, 0).integers(low, high)))

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """A mechanism on the table, moved and turned; where it stands nominally without a seed.

        Its first keyframe, `start`, is where the episode begins.
        """
        mechanism = self.instance(subtask, seed)
        x, y = mechanism.place
        turn = 0.0
        if seed is not None:
            rng = stream(seed, 1)
            x, y = x + rng.uniform(*self.config.shift), y + rng.uniform(*self.config.shift)
            turn = float(rng.uniform(*self.config.turn))
        return _scene(mechanism, (float(x), float(y)), turn, self.label)

    def episode(self, subtask: str, seed: int) -> Episode:
        """One episode."""
        scene, mechanism = self.scene(subtask, seed), self.instance(subtask, seed)
        rollout, _ = self._perform(scene.model, mechanism, seed)
        cast = Cast(
            tuple(prefix(mechanism) + part.name for part in mechanism.parts),
            robot=_ARM.site,
            surface="table",
            gripper=("left_finger", "right_finger"),
        )
        return make_episode(
            scene.model,
            cast,
            rollout,
            subtask=subtask,
            seed=seed,
            scene_hash=scene.fingerprint,
            control_timestep=self.control_timestep,
            success=succeeded(scene.model, mechanism, rollout.qpos),
        )

    def trials(self, count: int, seed: int, subtask: str | None = None) -> Scripted:
        """Episodes with one mechanism that stays where it is; the hand moves differently."""
        name = self.check_subtask(subtask)
        scene, mechanism = self.scene(name, seed), self.instance(name, seed)
        runs = [self._perform(scene.model, mechanism, seed + i) for i in range(count)]
        sequence = np.stack([rollout.ctrl for rollout, _ in runs])
        initial = State.stack([state for _, state in runs])
        return Scripted(scene, initial, sequence, self.control_timestep)

    def _perform(
        self, model: mujoco.MjModel, mechanism: Mechanism, seed: int
    ) -> tuple[Rollout, State]:
        rng, config = stream(seed, 2), self.config
        manner = Manner(
            speed=float(rng.uniform(*config.speed)),
            turning=float(rng.uniform(*config.turning)),
            step=self.control_timestep,
            offset=(float(rng.uniform(*config.slip)), 0.0, float(rng.uniform(*config.slip))),
        )
        start = np.array(_START)
        if stream(seed, 3).random() >= config.release:
            mechanism = without_release(mechanism)
        script = Script(
            (),
            _START,
            lambda stage: Operator(
                stage, prefix(mechanism), manner, start, pointing_down(mechanism.yaw)
            ).plan(mechanism),
            yaw=mechanism.yaw,
            grip=OPEN,
            joints=(0.0,) * len(mechanism.joints),
        )
        return perform(model, script, controller(_ARM), self.steps, self.control_timestep)


def without_release(mechanism: Mechanism) -> Mechanism:
    """With operations that leave out the first motion, or the first operation if it has no other:
    the hand pulls without having turned or pressed."""
    first, *others = mechanism.operations
    if len(first.motions) > 1:
        others = [dataclasses.replace(first, motions=first.motions[1:]), *others]
    return dataclasses.replace(mechanism, operations=tuple(others))


def succeeded(model: mujoco.MjModel, mechanism: Mechanism, qpos: Any) -> bool:
    """Whether the goal's joint was beyond the goal's position at some time; `qpos` [T, nq]."""
    joint, goal = mechanism.goal
    return bool((qpos[:, int(model.joint(prefix(mechanism) + joint).qposadr[0])] > goal).any())


def prefix(mechanism: Mechanism) -> str:
    """What the names of a mechanism's bodies and joints begin with in a scene."""
    return f"{mechanism.family}_"


@functools.lru_cache(maxsize=64)
def _read(family: str, number: int) -> mujoco.MjSpec:
    """An instance, through URDF, with its meshes in the document."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_urdf(make(family, number), Path(folder))
        spec = read_urdf(str(path)).spec
        embed(spec, [Path(folder)], str(path))
    return spec


def _scene(mechanism: Mechanism, place: tuple[float, float], turn: float, label: str) -> Scene:
    spec, start = assets.spec("mechanism"), prefix(mechanism)
    part = _read(mechanism.family, mechanism.number).copy()
    base = spec.worldbody.add_body(
        name=start + BASE, pos=[*place, 0.0], quat=[np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)]
    )
    spec.attach(part, frame=base.add_frame(), prefix=start)
    for text in list(spec.texts):
        spec.delete(text)
    write_carried(spec, [_renamed(effect, start) for effect in mechanism.effects])
    return assets.scene(spec, label)


def _renamed(effect: EffectInstance, start: str) -> EffectInstance:
    options = {
        name: start + value if name == "other" else value for name, value in effect.options.items()
    }
    return dataclasses.replace(effect, target=start + effect.target, options=options)
