"""Long recordings as overlapping pieces that are filtered side by side."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import numpy.typing as npt

from orbisim.recording.noise import roughness

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]

CORE, OVERLAP = 256, 128
LONGEST_GAP = 256.0
"""Sampling intervals over which missing samples are bridged."""
_SHARPEST = 3e-5
"""Noise that is assumed at least, in the signal's roughness: keeps the intensity in its range."""


@dataclasses.dataclass(frozen=True)
class Blocks:
    """Pieces of channels, side by side.

    Attributes:
      rows: [L, B] rows of the recording; those beyond its end repeat the last one.
      channel: [B]. core: [L, B] whether the piece answers for this row.
      step: [L - 1, B], measured: [L, B] as `kalman` wants them.
      offset: [B] what was subtracted from the values.
    """

    rows: Ints
    channel: Ints
    core: Bools
    step: Floats
    measured: Floats
    offset: Floats

    def __getitem__(self, series: Ints) -> Blocks:
        """Some of the pieces."""
        return Blocks(
            self.rows[:, series],
            self.channel[series],
            self.core[:, series],
            self.step[:, series],
            self.measured[:, series],
            self.offset[series],
        )

    @functools.cached_property
    def jump_level(self) -> Floats:
        """[B]: a jerk intensity that allows any change of rate seen in the piece."""
        slope = np.abs(np.nan_to_num(np.diff(self.measured, axis=0))) / np.maximum(self.step, 0.1)
        return np.asarray(100.0 * (1.0 + slope.max(axis=0, initial=0.0)) ** 2)

    def levels(self, level: Floats, jumped: Bools) -> Floats:
        """[L - 1, B]: the jerk's intensity in every interval; `level` is [B]."""
        return np.where(jumped, np.maximum(self.jump_level, 1e4 * level), level)


class Channels:
    """The channels of a recording in the units of their noise and sampling interval.

    Args:
      time: [T]. values: [T, C], at least two samples in each channel.
      noise: [C] standard deviation of the measurement noise; NaN for unknown.

    Attributes:
      unit: [C] typical interval between samples, s. noise: [C] as used.
      bridged: [T, C] whether the row is between samples that are near enough to bridge.
    """

    def __init__(self, time: Floats, values: Floats, noise: Floats) -> None:
        self.time, self.values = time, values
        seen = np.isfinite(values)
        self.unit = np.array([np.median(np.diff(time[column])) for column in seen.T])
        size = np.nan_to_num(np.abs(values)).max(axis=0, initial=0.0)
        floor = np.maximum(_SHARPEST * roughness(time, values), 1e-12 * size + 1e-150)
        self.noise = np.maximum(np.nan_to_num(noise), floor)
        since, until = self._since(seen), self._since(seen[::-1], backward=True)[::-1]
        self.bridged = since + until <= LONGEST_GAP
        self._reach = np.minimum(since, LONGEST_GAP)

    def __len__(self) -> int:
        return int(self.values.shape[1])

    def _since(self, seen: Bools, backward: bool = False) -> Floats:
        """[T, C]: intervals since the last sample; infinite before the first one."""
        time = -self.time[::-1] if backward else self.time
        last = np.where(seen, time[:, None], -np.inf)
        return np.asarray((time[:, None] - np.maximum.accumulate(last, axis=0)) / self.unit)

    def edge_distance(self, jumps: Bools) -> Floats:
        """[T, C]: intervals to the nearest end of a channel, long gap, or jump [T - 1, C]."""
        seen = np.isfinite(self.values) & self.bridged
        edge = ~self.bridged
        edge[[0, -1]] = True
        edge[1:] |= jumps | ~self.bridged[:-1]
        edge[:-1] |= jumps | ~self.bridged[1:]
        first, last = seen.argmax(axis=0), len(seen) - 1 - seen[::-1].argmax(axis=0)
        every = np.arange(len(self))
        edge[first, every] = edge[last, every] = True
        return np.minimum(self._since(edge), self._since(edge[::-1], backward=True)[::-1])

    @functools.cached_property
    def starts(self) -> Ints:
        """First core row of every piece."""
        count = len(self.time)
        return np.arange(0, 1 if count <= CORE + 2 * OVERLAP else count, CORE)

    def blocks(self, starts: Ints) -> Blocks:
        """The pieces that start at these rows, in all channels."""
        channel = np.repeat(np.arange(len(self)), len(starts))
        start = np.tile(starts, len(self))
        count = len(self.time)
        single = len(self.starts) == 1
        length = count if single else CORE + 2 * OVERLAP
        raw = np.maximum(start - OVERLAP, 0) + np.arange(length)[:, None]
        rows = np.minimum(raw, count - 1)
        inside = raw == rows
        core = inside & (raw >= start) & (single | (raw < start + CORE))
        values = np.where(inside, self.values[rows, channel], np.nan)
        offset = _first_sample(values)
        measured = (values - offset) / self.noise[channel]
        return Blocks(rows, channel, core, self._steps(rows, channel), measured, offset)

    def _steps(self, rows: Ints, channel: Ints) -> Floats:
        """Intervals; what a gap is longer than `LONGEST_GAP` is left out."""
        before = self._reach[rows[:-1], channel]
        full = np.diff(self.time[rows], axis=0) / self.unit[channel]
        return np.asarray(np.minimum(before + full, LONGEST_GAP) - before)

    def gather(self, blocks: Blocks, per_row: npt.NDArray[np.generic]) -> tuple[Ints, Ints, Floats]:
        """Rows, channels and values of the core rows of an array [L, B]."""
        channel = np.broadcast_to(blocks.channel, blocks.core.shape)
        return blocks.rows[blocks.core], channel[blocks.core], np.asarray(per_row[blocks.core])


def _first_sample(values: Floats) -> Floats:
    """[B]: the first value that is not NaN; 0 where all are."""
    first = np.isfinite(values).argmax(axis=0)
    return np.asarray(np.nan_to_num(values[first, np.arange(values.shape[1])]))
