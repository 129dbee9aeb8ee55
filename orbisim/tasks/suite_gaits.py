"""Rhythmic feedback policies of the suite's walking machines and of the finger.

The numbers were found by cross-entropy search on the return of the task named beside them. They
make the machines move in a repeatable way; they are far from the best there is.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.tasks.suite_policies import Policy

Floats = npt.NDArray[np.float64]
Row = tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class Gait:
    """Joint targets that swing, a spring and a damper to them, and feedback of the torso.

    Attributes:
      offset, amplitude, phase: of the target of each actuated joint, rad.
      pitch, pitch_rate: feedback of the torso's angle and rate to each control, 1/rad and s/rad.
      frequency: Hz. stiffness: control for each rad. damping: control for each rad/s.
    """

    offset: Row
    amplitude: Row
    phase: Row
    pitch: Row
    pitch_rate: Row
    frequency: float
    stiffness: float
    damping: float


GAITS = {
    "walker": Gait(  # walk
        offset=(0.303, 0.180, -0.250, 0.762, -0.484, 0.077),
        amplitude=(0.561, 0.901, 0.122, 0.583, 0.903, 0.306),
        phase=(-0.907, -0.085, 2.382, -1.371, -0.113, 0.792),
        pitch=(-0.248, 0.351, 0.548, -0.024, 0.159, 0.176),
        pitch_rate=(0.118, -0.309, -0.115, 0.032, -0.049, 0.036),
        frequency=1.734,
        stiffness=1.776,
        damping=0.016,
    ),
    "cheetah": Gait(  # run
        offset=(0.057, -0.117, -0.599, -0.056, -0.031, 0.100),
        amplitude=(1.301, 0.504, 0.912, 0.143, 0.201, 0.183),
        phase=(-0.962, 0.246, -0.428, 2.059, 1.774, 1.005),
        pitch=(-0.737, 0.012, -0.606, -0.047, 0.805, 0.357),
        pitch_rate=(0.001, -0.008, -0.258, -0.119, 0.064, -0.038),
        frequency=2.271,
        stiffness=2.131,
        damping=0.062,
    ),
    "finger": Gait(  # spin
        offset=(0.011, -0.102),
        amplitude=(0.918, 1.054),
        phase=(0.707, -0.960),
        pitch=(0.0, 0.0),
        pitch_rate=(0.0, 0.0),
        frequency=1.798,
        stiffness=2.849,
        damping=0.039,
    ),
    "hopper": Gait(
        offset=(0.0, 0.0, 0.0, 0.0),
        amplitude=(0.2, 0.5, 0.9, 0.5),
        phase=(0.0, 0.6, 1.9, 2.6),
        pitch=(0.0, 0.0, 0.0, 0.0),
        pitch_rate=(0.0, 0.0, 0.0, 0.0),
        frequency=1.5,
        stiffness=1.0,
        damping=0.02,
    ),
}
"""By domain; the actuators' order is the model's."""

_TORSO = 2
"""Coordinate of the torso's angle in the machines that have one."""


def gait_policy(gait: Gait, model: mujoco.MjModel) -> Policy:
    """The policy of a gait."""
    joints = model.actuator_trnid[:, 0]
    qpos, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    offset, amplitude, phase, pitch, rate = (
        np.array(row)
        for row in (gait.offset, gait.amplitude, gait.phase, gait.pitch, gait.pitch_rate)
    )

    def policy(data: mujoco.MjData) -> Floats:
        swing = amplitude * np.sin(2 * np.pi * gait.frequency * data.time + phase)
        spring = gait.stiffness * (offset + swing - data.qpos[qpos])
        torso = pitch * data.qpos[_TORSO] + rate * data.qvel[_TORSO]
        return np.asarray(spring - gait.damping * data.qvel[dofs] + torso)

    return policy
