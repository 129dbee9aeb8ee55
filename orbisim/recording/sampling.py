"""A signal at other times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.recording import names
from orbisim.recording import quaternions as quat
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]


def resampled(
    before: Floats,
    name: str,
    values: Floats,
    time: Floats,
    quaternions: Sequence[slice] | None = None,
) -> Floats:
    """A signal at other times: see `orbisim.recording.resample`.

    Args:
      before: [T], s, its own times. name: its name. values: [T] or [T, n].
      time: [N], s.
      quaternions: columns that form quaternions; None: what the name and the width say.
    """
    columns = values.reshape(len(values), -1)
    kind, _ = names.split(name)
    if kind in names.HELD:
        found = Held(before, columns).at(time)
    else:
        turning = _quaternions(name, columns) if quaternions is None else quaternions
        found = _interpolated(before, columns, time, turning)
    return found.reshape(len(time), *values.shape[1:])


def _quaternions(name: str, columns: Floats) -> list[slice]:
    """Columns of a named signal that form quaternions."""
    kind, target = names.split(name)
    if kind == "xquat":
        return [slice(0, 4)]
    if kind != "qpos" or not target:
        return []
    return {4: [slice(0, 4)], 7: [slice(3, 7)]}.get(columns.shape[1], [])


def _interpolated(
    before: Floats, values: Floats, time: Floats, quaternions: Sequence[slice]
) -> Floats:
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
