"""How true states appear in a recording: offsets, scales, delays and the clock.

A signal reads s x(t - d) + b at each degree of freedom (see `orbisim.effects.sensors`), with a law
of reading (`orbisim.effects.unnamed`) more by a function of x, and recorded durations are `clock`
times the true ones. Rotations of ball and free joints are read as
they are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import EffectInstance, names_of_kind
from orbisim.effects.catalogue import find
from orbisim.recording.joints import Kind, joints

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement:
    """A map from true to measured coordinates, [2 nv] numbers each; None for the identity.

    Attributes:
      clock: recorded over true durations.
      bias, scale: of positions and velocities. delay: s, of the same.
      laws: degrees of freedom with a law of reading: their number, and of each wave the periods a
        turn and the numbers of cosine and sine, rad.
    """

    clock: float = 1.0
    bias: Floats | None = None
    scale: Floats | None = None
    delay: Floats | None = None
    laws: tuple[tuple[int, tuple[tuple[int, float, float], ...]], ...] = ()

    def __bool__(self) -> bool:
        return self.bias is not None

    @property
    def shifted(self) -> bool:
        """Whether any reading is late, or early."""
        return self.delay is not None and bool(self.delay.any())

    def of(
        self, reference: Floats, deviation: Floats, time: Floats, stagger: float = 0.0
    ) -> Floats:
        """Measured minus reference coordinates.

        Args:
          reference: [W, K, 2 nv] absolute coordinates (zero where there are none).
          deviation: [W, K, 2 nv] true minus reference. time: [W, K], s.
          stagger: by how much before its position the velocity of a simulated state belongs, s:
            half a step of semi-implicit integrators.
        """
        if self.bias is None or self.scale is None or self.delay is None:
            return deviation
        truth = reference + deviation
        late = np.flatnonzero(self.delay)
        if late.size:
            truth = self._delayed(truth, reference, late, time, stagger)
        read = self.scale * truth + self.bias
        for q, waves in self.laws:
            v = q + truth.shape[-1] // 2
            for k, even, odd in waves:
                cos, sin = np.cos(k * truth[..., q]), np.sin(k * truth[..., q])
                read[..., q] += even * cos + odd * sin
                read[..., v] += k * (odd * cos - even * sin) * truth[..., v]
        return np.asarray(read - reference)

    def _delayed(
        self,
        truth: Floats,
        reference: Floats,
        late: npt.NDArray[np.int64],
        time: Floats,
        stagger: float,
    ) -> Floats:
        """Cubic in positions, and its slope in velocities; extrapolated at a window's ends: before
        it with the shape of what was measured, as that is the same motion late."""
        assert self.delay is not None
        out = truth.copy()
        for delay in np.unique(self.delay[late]):
            seen, first = _Between(time, time - delay), _Between(time, time[:, :1] + delay)
            early = (time < time[:, :1] + delay) & (time[:, :1] + delay < time[:, -1:])
            for c in late[self.delay[late] == delay]:
                shape = reference[..., c] - first.of(reference, c, noisy=True)
                before = truth[:, :1, c] + shape / self._scale(c)
                out[..., c] = np.where(early, before, seen.of(truth, c, stagger))
        return out

    def _scale(self, c: int) -> float:
        """Of one coordinate."""
        assert self.scale is not None
        return float(self.scale[c])


class _Between:
    """Places between samples.

    Args:
      time: [W, K] of the samples, s. at: [W, N] the places; what lies beyond the ends goes on as a
        straight line.
    """

    def __init__(self, time: Floats, at: Floats) -> None:
        rows = zip(time, at, strict=True)
        after = np.stack([np.searchsorted(t, wanted, side="right") for t, wanted in rows])
        self._k = np.clip(after - 1, 0, time.shape[1] - 2)
        start, stop = (np.take_along_axis(time, self._k + i, axis=1) for i in (0, 1))
        self._h, self._u = stop - start, (at - start) / (stop - start)
        self._inside = np.clip(self._u, 0.0, 1.0)

    def _sample(self, values: Floats, away: int) -> Floats:
        """[W, N]: of values [W, K], those of a sample so many after the one before a place."""
        k = np.clip(self._k + away, 0, values.shape[1] - 1)
        return np.take_along_axis(values, k, axis=1)

    def of(self, values: Floats, c: int, stagger: float = 0.0, noisy: bool = False) -> Floats:
        """[W, N]: one column of [W, K, 2 nv].

        Args:
          stagger: as of `Measurement.of`. What goes with what is asked for is moved to the time of
            that.
          noisy: whether positions are measured: they would make velocities noisy, which are linear
            between samples then.
        """
        nv, h, u, inside = values.shape[-1] // 2, self._h, self._u, self._inside
        y0, y1 = (self._sample(values[..., c % nv], i) for i in (0, 1))
        near = [self._sample(values[..., nv + c % nv], i) for i in (-1, 0, 1, 2)]
        v0, v1 = near[1:3]
        if c < nv:
            later = stagger * (v1 - v0) / h  # velocities, moved to the time of positions
            before, after = v0 + later, v1 + later
            cubic = _hermite(inside, y0, y1, h * before, h * after)
            return np.asarray(cubic + (u - inside) * h * np.where(u < 0, before, after))
        line = v0 + u * (v1 - v0)
        if noisy:
            return line
        slope = _hermite_slope(inside, y0 - stagger * v0, y1 - stagger * v1, h * v0, h * v1) / h
        most = np.ptp(near, axis=0) / _RESOLVED
        return line + np.clip(slope + (u - inside) * (v1 - v0) - line, -most, most)


def _hermite(u: Floats, y0: Floats, y1: Floats, d0: Floats, d1: Floats) -> Floats:
    """The cubic with values y0, y1 and slopes d0, d1 at u = 0 and 1."""
    return np.asarray(
        (1 + 2 * u) * (1 - u) ** 2 * y0
        + u * (1 - u) ** 2 * d0
        + u**2 * (3 - 2 * u) * y1
        + u**2 * (u - 1) * d1
    )


def _hermite_slope(u: Floats, y0: Floats, y1: Floats, d0: Floats, d1: Floats) -> Floats:
    """Its derivative by u: a parabola from d0 to d1 whose mean is y1 - y0."""
    return np.asarray(
        6 * u * (1 - u) * (y1 - y0) + (1 - u) * (1 - 3 * u) * d0 + u * (3 * u - 2) * d1
    )


_RESOLVED = 8.0
"""Range of velocities over four samples, over the most that a velocity between the middle two may
be off a straight line: of a parabola, it is 8 at least. What is further off is a motion that the
samples do not resolve, and a cubic through two of them swings."""

TRUE = Measurement()


def measurement_of(model: mujoco.MjModel, effects: Iterable[EffectInstance]) -> Measurement:
    """The map of some measurement effects; others are ignored."""
    nv, clock, changed = model.nv, 1.0, False
    bias, scale, delay = np.zeros(2 * nv), np.ones(2 * nv), np.zeros(2 * nv)
    laws: list[tuple[int, tuple[tuple[int, float, float], ...]]] = []
    places = dict(zip(names_of_kind(model, "joint"), joints(model), strict=True))
    for one in effects:
        changes = find(one.effect).measured_as
        if changes == "clock":
            clock *= one.values["factor"]
        joint = places.get(one.target)
        if joint is None or changes in ("", "clock"):
            continue
        changed = True
        width = 3 if joint.kind == Kind.FREE else 1
        q = np.arange(joint.v.start, joint.v.start + width)
        if changes in ("offset", "law"):
            bias[q] += one.values["offset"]
        if changes == "law":
            waves = tuple((k, one.values[f"cos{k}"], one.values[f"sin{k}"]) for k in (1, 2))
            laws.append((joint.v.start, waves))
        elif changes == "scale":
            scale[[*q, *(nv + q)]] *= one.values["factor"]
        elif changes == "delay":
            delay[[*q, *(nv + q)]] += one.values["delay"]
    if not changed:
        return Measurement(clock)
    return Measurement(clock, bias, scale, delay, tuple(laws))
