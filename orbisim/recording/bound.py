"""`Bound`: a recording in a scene's order."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording.recording import Recording
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Suspicion:
    """Something that looks wrong.

    Attributes:
      text: one sentence. wrong: whether a signal is clearly not what its name says, so that
        nothing should be fitted to it.
    """

    text: str
    wrong: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Bound:
    """A recording that fits a scene.

    Attributes:
      recording, scene: what was bound.
      time: [T], s.
      qpos: [T, nq], qvel: [T, nv]; NaN where missing. Quaternions have unit norm and no sign flips.
      ctrl: [T, nu] without NaN: a missing sample holds the one before it.
      torque: [T, nv] recorded generalized forces, NaN where there are none.
      applied: [nv] whether the recorded force drives the joint.
      switched_off: numbers of actuators that the recorded forces stand for.
      xpos, xquat: recorded poses [T, 3], [T, 4] by body number.
      sensordata: [T, nsensordata], NaN where not recorded.
      measured: numbers of the joints whose positions were measured (not inferred from others).
      unseen_turns: numbers of free joints whose orientation is not recorded and does not matter.
      notes: what was ignored, assumed or looks wrong.
      suspicions: those of the notes that say what looks wrong.
    """

    recording: Recording
    scene: Scene
    time: Floats
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    torque: Floats
    applied: Bools
    switched_off: tuple[int, ...]
    xpos: Mapping[int, Floats]
    xquat: Mapping[int, Floats]
    sensordata: Floats
    measured: frozenset[int]
    unseen_turns: frozenset[int]
    notes: tuple[str, ...]
    suspicions: tuple[Suspicion, ...] = ()

    @property
    def model(self) -> mujoco.MjModel:
        """The scene's model; read-only."""
        return self.scene.model
