"""Offset, scale and delay of one sensor: y(t) = s h(t - d) + b, where h is what it should read."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from orbisim.recording.sensors import Sensor
from orbisim.sensing.readings import Readings

Floats = npt.NDArray[np.float64]

# s: a delay that is looked for is at most so long
_LONGEST = 0.3
# readings one after the other that can be shifted against a motion
_SHORTEST_RUN = 12
# beyond them only each second, third ... is taken: a fault shows in fewer
_MOST_ROWS = 6_000
# delays that are tried, before the best is refined
_GRID = 61


class SensorData:
    """A sensor's readings in all recordings, and what they should be at any time.

    Rows close to the ends of a run are left out, so that every delay is judged on the same rows.

    Args:
      sensor: which. readings: of all recordings.
    """

    def __init__(self, sensor: Sensor, readings: Sequence[Readings]) -> None:
        self.sensor = sensor
        self.runs: list[tuple[Floats, Floats, CubicSpline]] = []
        pieces = [run for one in readings for run in _runs(one, sensor)]
        shortest = min((float(t[-1] - t[0]) for t, _, _ in pieces), default=0.0)
        self.reach = min(_LONGEST, shortest / 4)
        for time, measured, expected in pieces:
            inside = (time >= time[0] + self.reach) & (time <= time[-1] - self.reach)
            inside &= np.isfinite(measured).all(axis=1)
            if inside.sum() >= 4:
                curve = CubicSpline(time, expected, axis=0)
                self.runs.append((time[inside], measured[inside], curve))
        self.stride = max(1, self.rows // _MOST_ROWS)
        known = [one.spread[sensor.place] for one in readings]
        self.spread = np.sqrt(np.nanmean(np.square(np.nan_to_num(known)), axis=0))

    @property
    def rows(self) -> int:
        """Number of readings."""
        return sum(len(time) for time, _, _ in self.runs)

    @property
    def measured(self) -> Floats:
        """[N, n]."""
        return np.concatenate([values[:: self.stride] for _, values, _ in self.runs])

    @property
    def time(self) -> Floats:
        """[N], s."""
        return np.concatenate([time[:: self.stride] for time, _, _ in self.runs])

    def expected(self, delay: float = 0.0, derivative: int = 0) -> Floats:
        """[N, n]: what it should have read some time before, or that value's derivative."""
        return np.concatenate(
            [curve(time[:: self.stride] - delay, derivative) for time, _, curve in self.runs]
        )

    @property
    def offsets(self) -> tuple[str, ...]:
        """Names of the offsets of each component by itself."""
        width = self.sensor.width
        return tuple(f"offset {i}" for i in range(width)) if width > 1 else ("offset",)

    def weighted(self) -> tuple[Floats, Floats]:
        """Noise of the readings [n], and the standard deviations of measured less expected readings
        [n]."""
        full = fit_form(self, ("scale", *self.offsets, "delay"), np.ones(self.sensor.width))
        left = left_over(self, full.values)
        noise = np.sqrt(np.mean(np.diff(left, axis=0) ** 2, axis=0) / 2)
        size = np.sqrt(noise**2 + self.spread**2)
        return noise, np.maximum(size, 1e-9 * np.maximum(np.abs(self.measured).max(axis=0), 1e-9))


def _runs(one: Readings, sensor: Sensor) -> list[tuple[Floats, Floats, Floats]]:
    """Consecutive rows at which it is known what a sensor should read."""
    expected, measured = one.expected[:, sensor.place], one.measured[:, sensor.place]
    known = np.flatnonzero(np.isfinite(expected).all(axis=1))
    found = []
    for rows in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(rows) >= _SHORTEST_RUN:
            found.append((one.time[rows], measured[rows], expected[rows]))
    return found


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """A fit. values: by name. std: their standard deviations, by name, of independent data."""

    values: Mapping[str, float]
    std: Mapping[str, float]


def fit_form(data: SensorData, names: Sequence[str], size: Floats) -> Fitted:
    """Fits some of a sensor's numbers by least squares.

    Args:
      names: of `scale`, `offset` (of all components alike), `offset 0` ... (of one), `delay`.
      size: [n] standard deviations of the readings.
    """

    def square(delay: float) -> float:
        return float((_linear(data, names, size, delay)[1] ** 2).sum())

    delay = _best_delay(data.reach, square) if "delay" in names else 0.0
    found, left, jacobian = _linear(data, names, size, delay)
    if "delay" in names:
        found["delay"] = delay
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(jacobian.T @ jacobian)), 0.0))
    spread *= np.sqrt(max(float((left**2).mean()), 1.0))
    return Fitted(found, dict(zip(found, map(float, spread), strict=True)))


def _best_delay(reach: float, square: Callable[[float], float]) -> float:
    grid = np.linspace(-reach, reach, _GRID)
    best = int(np.argmin([square(d) for d in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    return float(minimize_scalar(square, bounds=(low, high), method="bounded").x)


def _linear(
    data: SensorData, names: Sequence[str], size: Floats, delay: float
) -> tuple[dict[str, float], Floats, Floats]:
    """Scale and offsets at a delay; what is left [N, n] and its derivatives [N n, P], weighted."""
    expected, unit = data.expected(delay) / size, np.eye(data.sensor.width)
    columns = {"scale": expected} if "scale" in names else {}
    for name in names:
        kind, _, axis = name.partition(" ")
        if kind == "offset":
            row = unit[int(axis)] if axis else unit.sum(axis=0)
            columns[name] = np.broadcast_to(row / size, expected.shape)
    target = data.measured / size - (0.0 if "scale" in names else expected)
    design = _stacked(columns.values(), target.size)
    values = np.linalg.lstsq(design, target.ravel(), rcond=None)[0]
    left = target - (design @ values).reshape(target.shape)
    if "delay" in names:
        columns["delay"] = -data.expected(delay, 1) / size
    found = dict(zip([n for n in columns if n != "delay"], map(float, values), strict=True))
    return found, left, _stacked(columns.values(), target.size)


def _stacked(columns: Iterable[Floats], rows: int) -> Floats:
    return np.stack([np.zeros(rows), *(one.ravel() for one in columns)], axis=1)[:, 1:]


def left_over(data: SensorData, values: Mapping[str, float]) -> Floats:
    """[N, n]: measured readings less those of a sensor with these numbers."""
    offset = np.full(data.sensor.width, values.get("offset", 0.0))
    for i in range(len(offset)):
        offset[i] += values.get(f"offset {i}", 0.0)
    expected = data.expected(values.get("delay", 0.0))
    return np.asarray(data.measured - values.get("scale", 1.0) * expected - offset)
