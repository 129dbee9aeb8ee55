"""Faults of sensors that do not read the joints themselves: gyros, force sensors and the like."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Bench
from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.found import Estimate, FoundEffect, Verdict
from orbisim.diagnosis.readings import (
    Readings,
    simulated_readings,
    smoothed_readings,
    usable_sensors,
)
from orbisim.diagnosis.refine import Judge, is_structural
from orbisim.diagnosis.sensor_fit import Fitted, Form, SensorData, fit_form, left_over
from orbisim.diagnosis.settings import Settings
from orbisim.effects import EffectInstance
from orbisim.effects.base import AXES
from orbisim.recording.sensors import Sensor

Floats = npt.NDArray[np.float64]

_NEAR = 1.5
_VISIBLE = 0.05
_MOST_LEFT = 0.35
"""Share of a sensor's error that a name for it may leave."""
_NAMES = {"scale": "sensor_scale", "offset": "sensor_bias", "delay": "sensor_delay"}
_PARAMETERS = {"scale": "factor", "offset": "offset", "delay": "delay"}


@dataclasses.dataclass(frozen=True, eq=False)
class SensorFinding:
    """What became of one sensor.

    Attributes:
      sensor: which. noise: standard deviation of its readings' noise, in `sensor.unit`.
      before, after: rms of measured less expected readings over the noise, without and with the
        effects.
      effects: what the sensor has; instances: the same for the augmented scene.
      time: [N] of held-out readings, s, and measured less expected ones there, [N, n],
        `left_before` without and `left_after` with the effects.
    """

    sensor: Sensor
    noise: float
    before: float
    after: float
    effects: tuple[FoundEffect, ...] = ()
    instances: tuple[EffectInstance, ...] = ()
    time: Floats = dataclasses.field(default_factory=lambda: np.zeros(0))
    left_before: Floats = dataclasses.field(default_factory=lambda: np.zeros((0, 1)))
    left_after: Floats = dataclasses.field(default_factory=lambda: np.zeros((0, 1)))


@dataclasses.dataclass(frozen=True, eq=False)
class Sensed:
    """What became of all sensors.

    Attributes:
      findings: of each that could be looked at.
      sure: whether the motion is predicted to within the noise, so that what is left of a sensor's
        readings is the sensor's.
    """

    findings: tuple[SensorFinding, ...] = ()
    sure: bool = True

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """Of all sensors."""
        return tuple(effect for one in self.findings for effect in one.effects)

    @property
    def instances(self) -> tuple[EffectInstance, ...]:
        """Of all sensors."""
        return tuple(effect for one in self.findings for effect in one.instances)

    @property
    def significant(self) -> bool:
        """Whether a sensor reads something else than it should."""
        return self.sure and any(one.before > _NEAR for one in self.findings)

    def verdict(self, motion: Verdict) -> Verdict:
        """The verdict on motion and sensors from that on the motion."""
        left = self.sure and any(one.after > _NEAR for one in self.findings)
        if motion == "no_residual" and not self.effects:
            return "unexplained" if left else "no_residual"
        if motion in ("no_residual", "explained"):
            return "partly_explained" if left else "explained"
        return "partly_explained" if self.effects else motion


def sense(
    found: Attribution,
    unseen: Bench,
    settings: Settings,
    notes: list[str],
    say: Callable[[str], None] = lambda _: None,
) -> Sensed:
    """Looks for offset, scale and delay of every recorded sensor.

    Args:
      found: the search for effects on the motion. unseen: held-out data for the last check.
      notes: what was not looked at is added.
    """
    chosen = usable_sensors(found.bench.samples, notes)
    if not chosen:
        return Sensed()
    say("looking at the sensors")
    sure = found.after.ratio <= _NEAR and not is_structural(found.after.hypothesis)
    fitted, apart = _readings(found, unseen, sure)
    findings = []
    for sensor in chosen:
        both = SensorData(sensor, fitted), SensorData(sensor, apart)
        if min(data.rows for data in both) < _FEWEST:
            notes.append(f"sensor {sensor.label!r} is not looked at: too few readings in a row")
            continue
        findings.append(_one(*both, settings))
    return Sensed(tuple(findings), sure)


_FEWEST = 20


def _readings(
    found: Attribution, unseen: Bench, sure: bool
) -> tuple[list[Readings], list[Readings]]:
    """Expected readings in the fitted and in the held-out recordings."""
    bench, hypothesis = found.bench, found.after.hypothesis
    if not sure:
        scene = hypothesis.scene(bench.scene)
        return smoothed_readings(bench.samples, scene), smoothed_readings(unseen.samples, scene)
    after = found.after
    fitted = simulated_readings(bench, hypothesis, after.windows, after.fit.start)
    judge = Judge(unseen, unseen.intervals)
    start = judge.score(hypothesis, judge.fitted).start
    return fitted, simulated_readings(unseen, hypothesis, judge.fitted.windows, start)


def _one(data: SensorData, unseen: SensorData, settings: Settings) -> SensorFinding:
    """The form that pays by an information criterion; each part must be seen, and help in both
    halves of the data."""
    width = data.sensor.width
    noise, size, alike = data.weighted()
    offsets = ("", "all", "each") if width > 1 else ("", "all")
    count = data.measured.size
    best = None
    for form in (Form(o, s, d) for o in offsets for s in (False, True) for d in (False, True)):
        one = fit_form(data, form, size, alike)
        cost = _cost(one, alike, count)
        if best is None or cost < _cost(best, alike, count):
            best = one
    assert best is not None
    kept = _kept(data, best, size, alike, settings)
    before, after = (_rms(left_over(data, values) / size) for values in ({}, kept))
    if _excess(after) > _MOST_LEFT * _excess(before) or not _possible(kept):
        kept, after = (
            {},
            before,
        )  # a name for the smaller part of what is wrong would be a wrong one
    finding = SensorFinding(
        data.sensor, float(np.sqrt(np.mean(noise**2))), before, after,
        time=unseen.time, left_before=left_over(unseen, {}), left_after=left_over(unseen, kept),
    )  # fmt: skip
    return _described(finding, data, unseen, kept, best, size, alike)


def _excess(ratio: float) -> float:
    """Amplitude beyond the noise, in units of the noise."""
    return float(np.sqrt(max(ratio**2 - 1.0, 0.0)))


def _possible(values: Mapping[str, float]) -> bool:
    """Whether the numbers are within the bounds of the effects that have them."""
    low, high = _SCALES
    return low <= values.get("scale", 1.0) <= high


_SCALES = (0.1, 10.0)


def _cost(one: Fitted, alike: float, count: int) -> float:
    """Bayesian information criterion, neighbouring residuals not being independent."""
    numbers = len(one.values)
    return one.square / alike + numbers * np.log(max(count / alike, 2.0))


def _kept(
    data: SensorData,
    best: Fitted,
    size: Floats,
    alike: float,
    settings: Settings,
) -> dict[str, float]:
    """Those fitted numbers that are worth it."""
    values = dict(best.values)
    while values:
        gains = {name: float(_drops(data, values, name, size).sum()) for name in values}
        weakest = min(gains, key=lambda name: gains[name])
        seen = gains[weakest] / data.measured.size > _VISIBLE
        paid = gains[weakest] / alike > settings.margin
        halves = np.array_split(_drops(data, values, weakest, size), 2)
        helps = min(float(half.sum()) for half in halves) > 0
        if seen and paid and helps:
            return values
        del values[weakest]
    return values


def _without(values: Mapping[str, float], name: str) -> dict[str, float]:
    return {key: value for key, value in values.items() if key != name}


def _drops(data: SensorData, values: dict[str, float], name: str, size: Floats) -> Floats:
    """[N]: how much the weighted squares of each reading grow without one of the numbers."""
    parts = [left_over(data, v) / size for v in (_without(values, name), values)]
    return np.asarray((parts[0] ** 2 - parts[1] ** 2).sum(axis=1))


def _described(
    finding: SensorFinding,
    data: SensorData,
    unseen: SensorData,
    kept: dict[str, float],
    best: Fitted,
    size: Floats,
    alike: float,
) -> SensorFinding:
    effects, instances = [], []
    for name, value in kept.items():
        kind, _, axis = name.partition(" ")
        options = {"axis": AXES[int(axis)]} if axis else {}
        parameter = _PARAMETERS[kind]
        half = 1.96 * best.std[name]
        unit = {"scale": "1", "delay": "s"}.get(kind, data.sensor.unit)
        evidence = {
            "held_out_error_without": _rms(left_over(unseen, _without(kept, name))),
            "held_out_error_with": _rms(left_over(unseen, kept)),
            "delta_bic": float(_drops(data, kept, name, size).sum()) / alike,
        }
        estimate = Estimate(value, unit, (value - half, value + half))
        instance = EffectInstance(_NAMES[kind], data.sensor.name, {parameter: value}, options)
        instances.append(instance)
        effects.append(
            FoundEffect(
                instance.effect, instance.target, {parameter: estimate}, False, evidence, options,
                data.sensor.unit,
            )
        )  # fmt: skip
    return dataclasses.replace(finding, effects=tuple(effects), instances=tuple(instances))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
