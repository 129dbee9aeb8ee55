"""Offset, scale and delay of one sensor: y(t) = s h(t - d) + b, where h is what it should read."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from orbisim.diagnosis.readings import Readings
from orbisim.recording.sensors import Sensor

Floats = npt.NDArray[np.float64]

_LONGEST = 0.3
_SHORTEST_RUN = 12
_MOST_ROWS = 6_000
_GRID = 61
_LAGS = 200


@dataclasses.dataclass(frozen=True)
class Form:
    """Which of the three a sensor has.

    Attributes:
      offset: no offset, `all` components alike, or `each` its own.
    """

    offset: str = ""
    scale: bool = False
    delay: bool = False

    def names(self, width: int) -> tuple[str, ...]:
        """The fitted numbers: `scale`, `offset` or `offset 0` ..., `delay`."""
        offsets = {"all": ("offset",), "each": tuple(f"offset {i}" for i in range(width))}
        return (
            *(("scale",) if self.scale else ()),
            *offsets.get(self.offset, ()),
            *(("delay",) if self.delay else ()),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """A fit of a form.

    Attributes:
      form: what was fitted. values: by name. std: their standard deviations, by name.
      left: [N, n] measured minus fitted readings. square: sum of its weighted squares.
    """

    form: Form
    values: dict[str, float]
    std: dict[str, float]
    left: Floats
    square: float


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

    def weighted(self) -> tuple[Floats, Floats, float]:
        """Noise of the readings [n], the standard deviations of measured less expected readings
        [n], and over how many samples what is left stays alike."""
        width = self.sensor.width
        full = Form("each" if width > 1 else "all", True, True)
        left = fit_form(self, full, np.ones(width)).left
        noise = np.sqrt(np.mean(np.diff(left, axis=0) ** 2, axis=0) / 2)
        size = np.sqrt(noise**2 + self.spread**2)
        size = np.maximum(size, 1e-9 * np.maximum(np.abs(self.measured).max(axis=0), 1e-9))
        return noise, size, _correlation_time(left / size)


def _runs(one: Readings, sensor: Sensor) -> list[tuple[Floats, Floats, Floats]]:
    """Consecutive rows at which it is known what a sensor should read."""
    expected, measured = one.expected[:, sensor.place], one.measured[:, sensor.place]
    known = np.flatnonzero(np.isfinite(expected).all(axis=1))
    found = []
    for rows in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(rows) >= _SHORTEST_RUN:
            found.append((one.time[rows], measured[rows], expected[rows]))
    return found


def _correlation_time(left: Floats) -> float:
    """Integrated autocorrelation time, in samples, of the worst column."""
    longest = 1.0
    for column in left.T:
        x = column - column.mean()
        power = float(x @ x)
        time = 1.0
        for lag in range(1, min(_LAGS, len(x) // 4)):
            share = float(x[:-lag] @ x[lag:]) / max(power, 1e-300)
            if share < 0.05:
                break
            time += 2 * share
        longest = max(longest, time)
    return longest


def fit_form(data: SensorData, form: Form, size: Floats, inflation: float = 1.0) -> Fitted:
    """Fits a form by least squares.

    Args:
      size: [n] standard deviations. inflation: of the variances of the fitted numbers.
    """
    delay = 0.0
    if form.delay:
        delay = _best_delay(data, form, size)
    values, left, jacobian = _linear(data, form, size, delay)
    square = float((left**2).sum())
    names = form.names(data.sensor.width)
    gram = jacobian.T @ jacobian
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(gram)), 0.0)) if names else np.zeros(0)
    spread *= np.sqrt(inflation * max(square / left.size, 1.0))
    found = dict(zip(names, [*values, *([delay] if form.delay else [])], strict=True))
    return Fitted(form, found, dict(zip(names, spread, strict=True)), left * size, square)


def _best_delay(data: SensorData, form: Form, size: Floats) -> float:
    def square(delay: float) -> float:
        return float((_linear(data, form, size, delay)[1] ** 2).sum())

    grid = np.linspace(-data.reach, data.reach, _GRID)
    best = int(np.argmin([square(d) for d in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    return float(minimize_scalar(square, bounds=(low, high), method="bounded").x)


def _linear(
    data: SensorData, form: Form, size: Floats, delay: float
) -> tuple[Floats, Floats, Floats]:
    """Scale and offsets at a delay; what is left [N, n] and its derivatives [N n, P], weighted."""
    expected, width = data.expected(delay) / size, data.sensor.width
    columns: list[npt.NDArray[Any]] = [expected] if form.scale else []
    if form.offset == "all":
        columns.append(np.broadcast_to(1 / size, expected.shape))
    elif form.offset == "each":
        columns += [np.broadcast_to(row / size, expected.shape) for row in np.eye(width)]
    target = data.measured / size - (0.0 if form.scale else expected)
    values, left = np.zeros(0), target
    if columns:
        design = np.stack([c.ravel() for c in columns], axis=1)
        values = np.linalg.lstsq(design, target.ravel(), rcond=None)[0]
        left = target - (design @ values).reshape(target.shape)
    if form.delay:
        columns = [*columns, -data.expected(delay, 1) / size]
    jacobian = [c.ravel() for c in columns]
    return values, left, np.stack(jacobian, axis=1) if jacobian else np.zeros((target.size, 0))


def left_over(data: SensorData, values: dict[str, float]) -> Floats:
    """[N, n]: measured readings less those of a sensor with these numbers."""
    offset = np.full(data.sensor.width, values.get("offset", 0.0))
    for i in range(len(offset)):
        offset[i] += values.get(f"offset {i}", 0.0)
    expected = data.expected(values.get("delay", 0.0))
    return np.asarray(data.measured - values.get("scale", 1.0) * expected - offset)
