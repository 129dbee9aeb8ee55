"""A recording at other times."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.recording.joints import joints
from orbisim.recording.recording import Recording
from orbisim.recording.sampling import resampled
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]


def resample(recording: Recording, time: Floats, scene: Scene | None = None) -> Recording:
    """The recording at other times within its own.

    Controls and torques are the values in force; orientations are interpolated along the arc
    between neighbouring samples, everything else linearly. A value is missing if either neighbour
    is; nothing is filtered, so resample to lower rates only what is smooth.

    Args:
      recording: the recording.
      time: [N], s, strictly increasing, from the first to the last sample at most.
      scene: needed for `qpos` of scenes with ball or free joints, to know the quaternions.

    Raises:
      InputError: times beyond the recording, or the scene is needed.
    """
    if time.min() < recording.time[0] or time.max() > recording.time[-1]:
        raise InputError(
            f"{recording.source} reaches from {recording.time[0]:.6g} to "
            f"{recording.time[-1]:.6g} s; cannot resample it from {time.min():.6g} to "
            f"{time.max():.6g} s"
        )
    signals = {
        name: resampled(recording.time, name, values, time, _quaternions(name, scene))
        for name, values in recording.signals.items()
    }
    return recording.replace(time=time, signals=signals)


def _quaternions(name: str, scene: Scene | None) -> list[slice] | None:
    """Columns of the whole array `qpos` that form quaternions; None for all other signals."""
    if name != "qpos":
        return None
    if scene is None:
        raise InputError("to resample the array 'qpos', pass the scene: it says what it holds")
    return [j.quat for j in joints(scene.model) if j.quat is not None]
