"""Velocities that were made of the positions, by differences and a filter.

Most drivers have no sensor of velocities: they take differences of positions and smooth them, while
they run or afterwards. Such velocities say nothing that the positions do not. They are late, or
blurred, a scene that is right misses them by that, and noise that is the positions' own counts
twice, as noise that lasts for as long as the filter.

A velocity that was measured by itself knows nothing of the noise of the positions. Whatever is
added up of slopes between positions around it, with weights u, is off from it by that noise: by
sigma |w| at least, where w are the weights of the positions and sigma is their noise. Of a velocity
that a linear filter has made of the same positions, whether it looks back, ahead, or to both sides,
the right weights leave nothing; with neighbouring velocities among what is added up, filters that
never forget (a low pass of first or second order, run once or to and fro) have few of them.
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
    told = [made for each in recordings for made in _of(each)]
    if 2 * sum(told) <= len(told):
        return list(recordings), list(others)
    found, also = ([_without(one) for one in part] for part in (recordings, others))
    return found, also


def _without(recording: Recording) -> Recording:
    pairs = _pairs(recording)
    if not pairs:
        return recording
    gone = {name for _, name in pairs}
    kept = {name: values for name, values in recording.signals.items() if name not in gone}
    note = (
        f"velocities ({', '.join(sorted(gone))}) were made of the positions, by differences and a "
        "filter: they were left out"
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


def _of(recording: Recording) -> list[bool]:
    """Of each velocity that moves, whether it was made of positions."""
    found = []
    for position, velocity in _pairs(recording):
        columns = (recording[n].reshape(len(recording), -1).T for n in (position, velocity))
        found += [_made(recording.time, q, v) for q, v in zip(*columns, strict=True)]
    return [made for made in found if made is not None]


def _made(time: Floats, q: Floats, v: Floats) -> bool | None:
    """Whether a velocity was made of the positions; None of few samples, or at rest."""
    reach = min(_REACH, len(time) // _SAMPLES)
    if reach < _NEAREST:
        return None
    steps, here = np.diff(time), np.arange(reach, len(time) - reach)
    step = float(np.median(steps))
    around = (np.diff(q) / steps)[here[:, None] + np.arange(-reach, reach)]
    columns = np.concatenate([around, v[here[:, None] + np.array(_BESIDE)]], axis=1)
    even = time[here + reach] - time[here - reach] < 1.5 * 2 * reach * step  # no gap
    known = even & np.isfinite(columns).all(axis=1) & np.isfinite(v[here])
    columns, wanted = columns[known], v[here][known]
    noise = float(noise_std(time, q))
    if len(wanted) < _EQUATIONS * columns.shape[1] or not np.ptp(wanted) > 0 or not noise > 0:
        return None
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    weights = np.linalg.lstsq(columns / size, wanted, rcond=None)[0] / size
    left = np.linalg.norm(wanted - columns @ weights) / np.sqrt(len(wanted) - len(weights))
    of_positions = np.diff(weights[: 2 * reach], prepend=0.0, append=0.0) / step
    return bool(left < _SHARE * noise * np.linalg.norm(of_positions))


_REACH, _NEAREST = 16, 8
"""Samples to either side that a filter may look at: as far as the polynomials reach that are used
to smooth logs, and as near as it takes to tell."""
_SAMPLES = 12
"""Of a recording, for each sample that is looked at to either side."""
_BESIDE = (-2, -1, 1, 2)
"""Samples at which velocities beside are looked at: filters of second order, to and fro."""
_EQUATIONS = 3
"""For each weight."""
_SHARE = 0.5
"""Of what the noise of the positions leaves at least of a velocity that was measured by itself; of
real and simulated machines that is 0.8 times to many thousand times, of exact filters 0.003 at
most."""
