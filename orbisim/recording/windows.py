"""Cutting a recording into windows."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError

Floats = npt.NDArray[np.float64]

_SHORT = 1.5
"""Sampling intervals by which the last window may be shorter than asked for."""


@dataclasses.dataclass(frozen=True)
class Rows:
    """Rows start, ..., stop - 1 of a recording."""

    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start


def cut(time: Floats, duration: float, usable: npt.NDArray[np.bool_] | None = None) -> list[Rows]:
    """Consecutive windows from the first sample on.

    Window k reaches from time[0] + k * duration to time[0] + (k + 1) * duration, both included, so
    that consecutive windows share a sample that falls on their border. What remains at the end is
    left out, unless it is short of a window by no more than 1.5 sampling intervals. A recording
    shorter than one window is one window.

    Args:
      time: [T], s.
      duration: of a window, s; 0 for a single window with everything.
      usable: [T] rows at which a window may start; a window starts at the first of its rows that
        is, and is left out if none is.

    Returns:
      Windows of at least two rows.

    Raises:
      InputError: the duration is negative or not finite.
    """
    if not (np.isfinite(duration) and duration >= 0):
        raise InputError(f"a window lasts 0 s (all of the recording) or longer; got {duration}")
    interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    total = float(time[-1] - time[0])
    short = min(_SHORT * interval, 0.5 * duration)
    count = np.floor((total + short) / duration) if duration > 0 else 0
    starts, ends = _borders(time, duration, count) if count else (time[:1], time[-1:])
    slack = 1e-6 * interval
    first = np.searchsorted(time, starts - slack, side="left")
    last = np.searchsorted(time, ends + slack, side="right")
    windows = [Rows(int(a), int(b)) for a, b in zip(first, last, strict=True)]
    if usable is not None:
        windows = [_from_usable(window, usable) for window in windows]
    return [window for window in windows if len(window) >= 2]


def _borders(time: Floats, duration: float, count: float) -> tuple[Floats, Floats]:
    """Starts and ends of the windows 0 to count - 1 that hold a sample, or have one beside them.

    There may be far more windows than samples: time may be in microseconds.
    """
    number = np.floor((time - time[0]) / duration)
    near = np.unique(np.concatenate([number - 1, number, number + 1]))
    near = near[(near >= 0) & (near < count)]
    return time[0] + duration * near, time[0] + duration * (near + 1)


def _from_usable(window: Rows, usable: npt.NDArray[np.bool_]) -> Rows:
    inside = usable[window.start : window.stop]
    skipped = int(inside.argmax()) if inside.any() else len(inside)
    return Rows(window.start + skipped, window.stop)
