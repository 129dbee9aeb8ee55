"""Angles in degrees that are called radians."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording.actuators import Actuator
from orbisim.recording.bound import Bound
from orbisim.recording.joints import Joint, Kind, joints

MOST = 10.0
"""Largest angle in radians that needs no word: more than one and a half turns."""


def suspect(values: npt.ArrayLike, joint: Joint, model: mujoco.MjModel) -> bool:
    """Whether angles of a joint, of any shape, are too large to be radians.

    A wheel turns further than this: whoever asks must have another reason, too.
    """
    seen = np.abs(np.asarray(values, np.float64))
    seen = seen[np.isfinite(seen)]
    most = MOST
    if model.jnt_limited[joint.id]:
        most = max(most, float(np.abs(model.jnt_range[joint.id]).max()))
    return joint.kind == Kind.HINGE and bool(seen.size) and float(seen.max()) > most


def suspected(bound: Bound) -> list[Joint]:
    """Joints whose measured positions are too large to be radians."""
    return [
        joint
        for joint in joints(bound.model)
        if joint.id in bound.measured and suspect(bound.qpos[:, joint.q], joint, bound.model)
    ]


def commands_angle(actuator: Actuator, model: mujoco.MjModel) -> bool:
    """Whether a control is the angle that a servo goes to: its force is kp (ctrl - angle) - ..."""
    if actuator.joint < 0 or model.jnt_type[actuator.joint] != int(Kind.HINGE):
        return False
    gain, bias = model.actuator_gainprm[actuator.id], model.actuator_biasprm[actuator.id]
    return bool(gain[0] > 0 and bias[1] == -gain[0])
