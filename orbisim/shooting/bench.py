"""Recordings cut into windows: what hypotheses are fitted to and checked on."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.linear import IntervalMap, Intervals, extrapolated, linearize
from orbisim.motion.samples import Samples
from orbisim.recording.command_clock import Lead
from orbisim.scene import Scene
from orbisim.shooting.cutting import (
    TOO_SHORT,
    every_third,
    most_intervals,
    predictable_windows,
    spread_windows,
    touches,
    without_lost,
)
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.impacts import near_jump
from orbisim.shooting.lasting import lasting_noise
from orbisim.shooting.noise import between_impacts, estimate_noise
from orbisim.shooting.shooter import Shooter
from orbisim.shooting.windows import Windows

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]
Noise = tuple[Floats, Floats]


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """A scene as declared, and windows of recordings to explain.

    Attributes:
      scene: as declared. samples: the recordings.
      rows: for each recording the rows at which usable intervals start.
      intervals: of the declared scene. windows: all windows.
      fit, check: which windows parameters are fitted to, and which choices are checked on.
      noise: standard deviations of positions and velocities.
      contacts: whether the motion has contacts, where derivatives hold only close by.
      deadline: when simulation ends with `TimeIsUpError`.
      lead: by how much controls and recorded forces change before the sample that logs them
        (`orbisim.motion.samples.Samples.led`); None where that is not asked.
    """

    scene: Scene
    samples: tuple[Samples, ...]
    rows: tuple[npt.NDArray[np.int64], ...]
    intervals: Intervals
    windows: Windows
    fit: Bools
    check: Bools
    noise: Noise
    contacts: bool = False
    deadline: Deadline = NEVER
    lead: Lead | None = None

    @functools.cached_property
    def smooth(self) -> Bools:
        """[W]: windows without impacts; where nothing touches, a jump of a velocity is none."""
        windows = self.windows
        if not self.contacts:
            return np.ones(len(windows), bool)
        near = [near_jump(one) for one in self.samples]
        first = zip(windows.recording, self.intervals.row[windows.first], strict=True)
        return np.array([not near[i][r : r + windows.length + 1].any() for i, r in first], bool)

    @property
    def looked_at(self) -> float:
        """Share of the usable sampling intervals that windows are cut from: steps through contacts
        take long, and of many some are left out."""
        usable = sum(len(_usable(one)) for one in self.samples)
        return sum(len(rows) for rows in self.rows) / max(usable, 1)

    @property
    def rugged(self) -> bool:
        """Whether most windows have impacts: what the others say is not typical then."""
        return bool(self.smooth.mean() < 0.5)

    def shooter(self, keep: Bools) -> Shooter:
        """Simulates the chosen windows."""
        return Shooter(
            self.scene, self.samples, self.intervals, self.windows.some(keep), self.noise,
            self.deadline,
        )  # fmt: skip

    def flow(self, hypothesis: Hypothesis) -> IntervalMap:
        """The map of a hypothesis over all sampling intervals."""
        clock = hypothesis.measurement(self.scene).clock
        scene = hypothesis.scene(self.scene)
        return IntervalMap(self.scene, self.samples, self.rows, scene, clock, self.deadline)

    def known_signal(self, hypothesis: Hypothesis) -> list[Floats]:
        """What the measurement effects of a hypothesis add to each recording, [T, 2 nv]."""
        measurement = hypothesis.measurement(self.scene)
        found = []
        for one in self.samples:
            still = np.zeros((1, *one.absolute.shape))
            found.append(measurement.of(one.absolute[None], still, one.time[None])[0])
        return found

    def led(self, lead: Lead) -> Bench:
        """With controls that lead their samples."""
        samples = tuple(one.led(lead) for one in self.samples)
        return dataclasses.replace(self, samples=samples, lead=lead)

    def whole(self, noise: Noise | None = None) -> Bench:
        """All windows are fitted and checked; with another noise, if one is given."""
        every = np.ones(len(self.windows), bool)
        return dataclasses.replace(self, noise=noise or self.noise, fit=every, check=every)

    def with_noise_of(self, hypothesis: Hypothesis, intervals: Intervals) -> Bench:
        """The same bench with the noise estimated along a better scene."""
        windows, known = self.windows.some(self.fit), self.known_signal(hypothesis)
        flow = self.flow(hypothesis) if self.contacts else None
        noise = _noise_of(self.samples, intervals, windows, flow, known)
        return dataclasses.replace(self, noise=noise)


def _usable(one: Samples) -> Ints:
    """Rows at which intervals start of which both ends and what drives them are known."""
    return np.flatnonzero(one.usable[:-1] & one.usable[1:] & one.driven[:-1])


def _lower(found: Noise, samples: Sequence[Samples]) -> Noise:
    """The lower of two estimates, both of which take unknown motion for noise; not below what
    rounding to the sensors' steps leaves, which repeats itself where motion is slow."""
    one, nv = samples[0], len(found[0])
    q, v = np.fmin(found[0], one.q_noise), np.fmin(found[1], one.v_noise)
    return np.maximum(q, one.rounding[:nv]), np.maximum(v, one.rounding[nv:])


def _noise_of(
    samples: Sequence[Samples],
    intervals: Intervals,
    windows: Windows,
    flow: IntervalMap | None,
    known: Sequence[Floats] | None = None,
) -> Noise:
    """Noise of positions and velocities; with rounding and, of positions where bodies touch, what
    lasts. flow: of the intervals, where bodies touch; else None."""
    if flow is None:
        return _lower(estimate_noise(samples, intervals, windows, known), samples)
    between = between_impacts(samples, intervals, windows)
    q, v = _lower(estimate_noise(samples, intervals, between, known), samples)
    if between is windows:  # no stretches without impacts
        return q, v
    forms = intervals, extrapolated(flow, intervals)
    return np.fmax(q, lasting_noise(samples, forms, between, known)), v


def make_bench(
    scene: Scene,
    samples: Sequence[Samples],
    window: float,
    check: float = 0.3,
    noise: Noise | None = None,
) -> Bench:
    """Cuts recordings into windows.

    Args:
      scene: as declared. samples: recordings that parameters and choices may see.
      window: duration of a window, s. check: share of the windows that choices are checked on.
      noise: standard deviations of positions and velocities, where they are known already.

    Raises:
      InputError: the recordings are too short for a window.
    """
    rows = [_usable(one) for one in samples]
    if not sum(len(r) for r in rows):
        raise InputError("no two consecutive samples are usable")
    contacts = touches(scene, samples)
    step = float(np.median(np.concatenate([np.diff(s.time) for s in samples])))
    length = int(np.clip(round(window / step), 4, 200))
    windows, kept = spread_windows(samples, rows, length, most_intervals(scene, contacts))
    flow = IntervalMap(scene, samples, kept)
    intervals = linearize(flow)
    windows = without_lost(windows, intervals)
    if not len(windows):
        raise InputError(TOO_SHORT)
    if contacts:
        noise = noise or _noise_of(samples, intervals, windows, flow)
        windows = without_lost(
            predictable_windows(scene, samples, intervals, noise, windows.length), intervals
        )
    held = every_third(windows, len(samples), check)
    fitted = windows.some(~held)
    noise = noise or _noise_of(samples, intervals, fitted, flow if contacts else None)
    return Bench(
        scene, tuple(samples), tuple(kept), intervals, windows, ~held, held, noise, contacts
    )
