"""Fewer samples where a recording has many more than a search of its windows needs."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.recording import Recording, names
from orbisim.recording.command_clock import Lead
from orbisim.recording.zero_order_hold import led

Floats = npt.NDArray[np.float64]

MOST_SAMPLES = 200
"""Sampling intervals of a window at most."""


WINDOW = 0.5
"""Duration of a window, s: friction and loads show within it, and chaos does not yet."""
FEW_SAMPLES = 30
"""In a window, of which a motion hardly shows."""
MOST_OF_TIME = 0.75
"""A window is no longer than recordings that hold this share of the recorded time: in shorter ones
no window fits."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Thinned(Recording):
    """A recording with fewer samples than are known of its controls; it has their means.

    Attributes:
      whole: controls and torques at these samples and at those in between.
    """

    whole: Recording = dataclasses.field(kw_only=True)

    def __reduce__(self) -> tuple[Any, ...]:
        return (functools.partial(Thinned, whole=self.whole), super().__reduce__()[1])


def thinned_of(one: Recording, whole: Recording) -> Thinned:
    """Samples of a recording, with the means of controls until the next.

    Args:
      one: the samples. whole: has all of these times, and more.
    """
    rows = np.searchsorted(whole.time, one.time)
    held = {
        name: _means(whole.time, values, rows)
        for name, values in whole.signals.items()
        if names.split(name)[0] in names.HELD
    }
    kept = {f.name: getattr(one, f.name) for f in dataclasses.fields(Recording)}
    return Thinned(**{**kept, "signals": {**one.signals, **held}}, whole=whole)


def usual_window(recordings: Sequence[Recording]) -> float:
    """Duration of windows, s: `WINDOW`, or less (but no fewer than `FEW_SAMPLES`) where recordings
    that hold most of the time are shorter; or, where that has few samples, twice as many as few;
    at most a third of the longest recording, so that there are several."""
    steps = [np.diff(one.time) for one in recordings if len(one) > 1]
    if not steps:
        return WINDOW
    step = float(np.median(np.concatenate(steps)))
    if FEW_SAMPLES * step <= WINDOW:
        lasting = np.sort([float(one.time[-1] - one.time[0]) for one in recordings])
        held = np.cumsum(lasting[::-1])[::-1]  # time in recordings at least so long
        most = lasting[held >= MOST_OF_TIME * lasting.sum()][-1]
        return float(min(WINDOW, max(FEW_SAMPLES * step, most)))
    longest = max(float(one.time[-1] - one.time[0]) for one in recordings)
    return float(max(WINDOW, min(2 * FEW_SAMPLES * step, longest / 3)))


def thinned(recordings: Sequence[Recording], window: float, notes: list[str]) -> list[Recording]:
    """Recordings with at most `MOST_SAMPLES` intervals to a window: every so many samples is kept.

    Controls and torques become their means over what is left out, so that their impulse stays;
    simulations in shorter steps take them from `Thinned.whole`.

    Args:
      window: duration, s. notes: gets a line if anything is left out.
    """
    found, left_out = [], 0
    for one in recordings:
        every = _every(one, window)
        found.append(one if every == 1 else _kept(one, every))
        left_out += len(one) - len(found[-1])
    if left_out:
        total = sum(len(one) for one in recordings)
        notes.append(
            f"windows of {window:g} s have more than {MOST_SAMPLES} samples: the search takes "
            f"{total - left_out} of {total}, and all controls in between"
        )
    return found


def held_led(recordings: Sequence[Recording], lead: Lead) -> list[Recording]:
    """Recordings with controls and torques that change before the samples that log them; those of
    one kind follow one clock."""
    return [
        thinned_of(one, _led(one.whole, lead)) if isinstance(one, Thinned) else _led(one, lead)
        for one in recordings
    ]


def _led(one: Recording, lead: Lead) -> Recording:
    changed: dict[str, Floats] = {}
    for kind in names.HELD:
        held = [n for n in one.signals if names.split(n)[0] == kind]
        if held:
            wide = [one.signals[n].reshape(len(one), -1) for n in held]
            values = np.concatenate(wide, axis=1)
            means = led(values, lead.shares(one.time, values))[:, 0]
            ends = np.cumsum([part.shape[1] for part in wide])[:-1]
            parts = zip(held, np.split(means, ends, axis=1), strict=True)
            changed |= {n: part.reshape(one.signals[n].shape) for n, part in parts}
    return one.replace(signals={**one.signals, **changed})


def _every(one: Recording, window: float) -> int:
    """How many samples make one."""
    if len(one) < 2:
        return 1
    step = float(np.median(np.diff(one.time)))
    return max(1, int(np.ceil(window / step / MOST_SAMPLES - 1e-6)))


def _kept(one: Recording, every: int) -> Recording:
    part = one.rows(np.arange(0, len(one), every))
    return thinned_of(part, one.whole if isinstance(one, Thinned) else one)


def _means(time: Floats, values: Floats, rows: npt.NDArray[np.intp]) -> Floats:
    """Means of a held signal from each row to the next; missing where a sample is missing. What
    does not change in between stays to the bit: clocks are told by where commands change."""
    columns = values.reshape(len(values), -1)
    first = columns[rows]
    step = np.diff(time, append=time[-1] + (time[-1] - time[-2]))[:, None]
    later = columns - np.repeat(first, np.diff(rows, append=len(columns)), axis=0)
    mean = np.add.reduceat(later * step, rows, axis=0) / np.add.reduceat(step, rows, axis=0)
    return np.asarray((first + mean).reshape(-1, *values.shape[1:]))
