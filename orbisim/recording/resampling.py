"""A recording at other times."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.recording import names
from orbisim.recording import quaternions as quat
from orbisim.recording.joints import joints
from orbisim.recording.recording import Recording
from orbisim.recording.zero_order_hold import Held
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
        name: _signal(recording, name, values, time, scene)
        for name, values in recording.signals.items()
    }
    return recording.replace(time=time, signals=signals)


def _signal(
    recording: Recording, name: str, values: Floats, time: Floats, scene: Scene | None
) -> Floats:
    columns = values.reshape(len(values), -1)
    kind, _ = names.split(name)
    if kind in names.HELD:
        found = Held(recording.time, columns).at(time)
    else:
        found = _interpolated(recording.time, columns, time, _quaternions(name, columns, scene))
    return found.reshape(len(time), *values.shape[1:])


def _quaternions(name: str, columns: Floats, scene: Scene | None) -> list[slice]:
    """Columns of a signal that form quaternions."""
    kind, target = names.split(name)
    if kind == "xquat":
        return [slice(0, 4)]
    if kind != "qpos":
        return []
    if target:
        return {4: [slice(0, 4)], 7: [slice(3, 7)]}.get(columns.shape[1], [])
    if scene is None:
        raise InputError("to resample the array 'qpos', pass the scene: it says what it holds")
    return [j.quat for j in joints(scene.model) if j.quat is not None]


def _interpolated(before: Floats, values: Floats, time: Floats, quaternions: list[slice]) -> Floats:
    row = np.clip(np.searchsorted(before, time, side="right") - 1, 0, max(len(before) - 2, 0))
    if len(before) == 1:
        return values[row]
    part = ((time - before[row]) / (before[row + 1] - before[row]))[:, None]
    low, high = values[row], values[row + 1]
    found = np.where(part == 0, low, np.where(part == 1, high, low + part * (high - low)))
    for place in quaternions:
        turn = quat.log(quat.multiply(quat.conjugate(low[:, place]), high[:, place]))
        arc = quat.multiply(low[:, place], quat.exp(part * turn))
        exact = (part == 0) | (part == 1)
        found[:, place] = np.where(exact, found[:, place], arc)
    return np.asarray(found)
