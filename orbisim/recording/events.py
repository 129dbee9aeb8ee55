"""Impacts and stray measurements: what the model of a smooth signal with white noise leaves out."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from orbisim.recording.blocks import Blocks
from orbisim.recording.kalman import Posterior

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]

_APART, _TALL = 4, 0.25
"""Rows between two events; share of the highest evidence that an event has at least."""
_JUMP_GAIN, _STRAY_GAIN = 6.0, 12.0
"""Log likelihood that each jump and each stray measurement must bring."""


@dataclasses.dataclass(frozen=True)
class Events:
    """What happened in the pieces of a recording.

    Attributes:
      jumped: [L - 1, B] whether the rate jumped within an interval.
      stray: [L, B] whether a measurement is left out.
    """

    jumped: Bools
    stray: Bools

    @classmethod
    def none(cls, blocks: Blocks) -> Events:
        """Nothing happened."""
        return cls(np.zeros(blocks.step.shape, bool), np.zeros(blocks.measured.shape, bool))

    def __getitem__(self, series: Ints) -> Events:
        return Events(self.jumped[:, series], self.stray[:, series])

    def only(self, series: Bools) -> Events:
        """The events of some series [B], none in the others."""
        return Events(self.jumped & series, self.stray & series)

    def __or__(self, other: Events) -> Events:
        return Events(self.jumped | other.jumped, self.stray | other.stray)

    def placed(self, series: Ints, count: int) -> Events:
        """As events of `count` series, of which these are some."""
        full = Events(
            np.zeros((len(self.jumped), count), bool), np.zeros((len(self.stray), count), bool)
        )
        full.jumped[:, series], full.stray[:, series] = self.jumped, self.stray
        return full

    @property
    def any(self) -> Bools:
        """[B]: whether something happened."""
        return np.asarray(self.jumped.any(axis=0) | self.stray.any(axis=0))

    @property
    def price(self) -> Floats:
        """[B]: how much the log likelihood must rise for these events to be believed."""
        jumps, strays = self.jumped.sum(axis=0), self.stray.sum(axis=0)
        return np.asarray(_JUMP_GAIN * jumps + _STRAY_GAIN * strays)

    def applied(self, blocks: Blocks) -> Blocks:
        """The blocks without the stray measurements."""
        if not self.stray.any():
            return blocks
        return dataclasses.replace(blocks, measured=np.where(self.stray, np.nan, blocks.measured))


def suspects(posterior: Posterior, blocks: Blocks, known: Events, count: int) -> Events:
    """New events: evidence above chance, not far below the piece's largest, largest around.

    Args:
      posterior: with the known events applied.
      blocks: as they were measured. known: events found before.
      count: samples in the recording, for what chance may produce.
    """
    seen = np.isfinite(blocks.measured) & ~known.stray
    jump = np.where(known.jumped | ~_inside(seen), 0.0, posterior.shock)
    stray = np.where(seen, posterior.outlier, 0.0)
    highest = np.maximum(jump.max(axis=0, initial=0.0), stray.max(axis=0, initial=0.0))
    threshold = np.maximum(2.0 * np.log(count) + 8.0, _TALL * highest)
    around_jump, around_stray = _around(jump), _around(stray)
    rival = np.minimum(around_stray[:-1], around_stray[1:])
    jumped = (jump >= threshold) & (jump >= around_jump) & (jump > rival)
    padded = np.concatenate([around_jump, around_jump[-1:]])
    return Events(jumped, (stray >= threshold) & (stray >= around_stray) & (stray >= padded))


def _inside(seen: Bools) -> Bools:
    """Intervals with two samples or more on either side: elsewhere a jump fits anything."""
    before = np.cumsum(seen, axis=0)
    return np.asarray((before[:-1] >= 2) & (before[-1] - before[:-1] >= 2))


def _around(evidence: Floats) -> Floats:
    """Running maximum over `_APART` rows to either side."""
    return np.asarray(maximum_filter1d(evidence, 2 * _APART + 1, axis=0, mode="nearest"))
