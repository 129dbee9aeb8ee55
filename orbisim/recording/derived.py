"""Velocities that were made of the positions, by a difference and a filter.

Most drivers have no sensor of velocities: they take differences of positions and smooth them. Such
velocities say nothing that the positions do not, and they are late, by a few samples at high speed
of change: a scene that is right misses them by that, and noise that is the positions' own counts
twice. A first-order low pass of the true velocity, dv/dt = (dq/dt - v) / tau, has

    q(b) - q(a) - integral of v from a to b = tau (v(b) - v(a)),

exactly, and a plain difference the same with half a sampling interval. Of a velocity that was
measured by itself, the left side has at least the noise of two positions; of one that was made of
the same positions that noise is on both sides, and what is left is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.recording.noise import noise_std
from orbisim.recording.recording import Recording

Floats = npt.NDArray[np.float64]


def independent(
    recordings: Sequence[Recording], others: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Recordings of one machine without velocities that were made of the positions, if most of
    their velocities were; else as they are. A note says so.

    Args:
      recordings: any. others: of the same machine, which have no say.

    Returns:
      Both, in their order.
    """
    told = [one for each in recordings for one in _of(each)]
    late = [lag for lag, made in told if made]
    if 2 * len(late) <= len(told) or not late:
        return list(recordings), list(others)
    lag = float(np.median(late))
    found, also = ([_without(one, lag) for one in part] for part in (recordings, others))
    return found, also


def _without(recording: Recording, lag: float) -> Recording:
    pairs = _pairs(recording)
    if not pairs:
        return recording
    gone = {name for _, name in pairs}
    kept = {name: values for name, values in recording.signals.items() if name not in gone}
    note = (
        f"velocities ({', '.join(sorted(gone))}) were made of the positions, which they follow "
        f"{1e3 * lag:.3g} ms late: they were left out"
    )
    return recording.replace(signals=kept, notes=(*recording.notes, note))


def _pairs(recording: Recording) -> list[tuple[str, str]]:
    """Names of positions and their velocities, of joints with one coordinate each."""
    signals = recording.signals
    found = [(n, "qvel" + n[4:]) for n in signals if n.split("/")[0] == "qpos"]
    return [
        (position, velocity)
        for position, velocity in found
        if velocity in signals and signals[position].shape == signals[velocity].shape
    ]


def _of(recording: Recording) -> list[tuple[float, bool]]:
    """Of each velocity that moves: how late it is, s, and whether it was made of positions."""
    found = []
    for position, velocity in _pairs(recording):
        columns = (recording[n].reshape(len(recording), -1).T for n in (position, velocity))
        for q, v in zip(*columns, strict=True):
            told = _told(recording.time, q, v)
            if told is not None:
                found.append(told)
    return found


def _told(time: Floats, q: Floats, v: Floats) -> tuple[float, bool] | None:
    """How late a velocity is, s, and whether it was made of the positions; None of few samples."""
    steps = np.diff(time)
    passed = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * steps)])
    first = np.arange(0, len(time) - _APART, _APART // 2)
    last = first + _APART
    even = time[last] - time[first] < 1.5 * _APART * float(np.median(steps))  # no gap
    left = (q[last] - q[first]) - (passed[last] - passed[first])
    change = v[last] - v[first]
    known = np.isfinite(left) & np.isfinite(change) & even
    left, change = left[known], change[known]
    noise = float(noise_std(time, q))
    if len(left) < _FEWEST or not change.any() or not noise > 0:
        return None
    lag = float(left @ change / (change @ change))
    rest = float(np.sqrt(np.mean((left - lag * change) ** 2)))
    return lag, rest < _SHARE * np.sqrt(2) * noise


_APART = 12
"""Samples between the two ends: a filter forgets within them, and there are many pairs."""
_FEWEST = 20
"""Pairs that tell."""
_SHARE = 0.5
"""Of the noise of two positions: one that was measured by itself leaves all of it, one that was
made of them nothing but what a filter of higher order does."""
