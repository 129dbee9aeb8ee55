"""Which offset, scale or delay a sensor has: the one comparison of explanations
(`orbisim.evidence`), by stretches of its readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects import EffectInstance, effect_names, find
from orbisim.effects.base import AXES
from orbisim.effects.estimate import Estimate, FoundEffect
from orbisim.evidence import EFFECT, NEAR, Blocks, Gain, gain, independent_share
from orbisim.recording.sensors import Sensor
from orbisim.sensing.forms import Fitted, SensorData, fit_form, left_over
from orbisim.sensing.readings import Readings

Floats = npt.NDArray[np.float64]

_MOST_LEFT = 0.35
"""Share of a sensor's error that a name for it may leave: for the smaller part of what is wrong it
would be a wrong name."""
# stretches of the recordings that are compared: more would be too short to stand alone
_STRETCHES = 24
# readings, with and without a suspect, below which nothing is compared
_FEWEST = 20


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
    effects: tuple[FoundEffect, ...]
    instances: tuple[EffectInstance, ...]
    time: Floats
    left_before: Floats
    left_after: Floats


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
        return self.sure and any(one.before > NEAR for one in self.findings)

    @property
    def unexplained(self) -> bool:
        """Whether one still does with its effects."""
        return self.sure and any(one.after > NEAR for one in self.findings)


def faults(
    chosen: Sequence[Sensor],
    fitted: Sequence[Readings],
    unseen: Sequence[Readings],
    sure: bool,
    notes: list[str],
) -> Sensed:
    """Looks for offset, scale and delay of sensors.

    Args:
      fitted: readings that decide. unseen: held-out ones, which only report.
      sure: see `Sensed`. notes: what was not looked at is added.
    """
    findings = []
    for sensor in chosen:
        data, apart = SensorData(sensor, fitted), SensorData(sensor, unseen)
        if min(data.rows, apart.rows) < _FEWEST:
            notes.append(f"sensor {sensor.label!r} is not looked at: too few readings in a row")
            continue
        findings.append(_one(data, apart))
    return Sensed(tuple(findings), sure)


@dataclasses.dataclass(frozen=True, eq=False)
class _Explained:
    """A fit, by how much of it each number is worth beside the others, and what it is worth."""

    fitted: Fitted
    gains: Mapping[str, Gain]
    worth: Gain


def _one(data: SensorData, unseen: SensorData) -> SensorFinding:
    """The numbers that are surely worth it, of all components together or of each."""
    noise, size = data.weighted()
    scorer = _Scorer(data, size)
    starts = dict.fromkeys([("scale", "offset", "delay"), ("scale", *data.offsets, "delay")])
    best = max((scorer.reduced(names) for names in starts), key=lambda one: one.worth.total)
    kept = best.fitted.values
    before, after = (_rms(left_over(data, values) / size) for values in ({}, kept))
    if _excess(after) > _MOST_LEFT * _excess(before) or not _possible(kept):
        best, kept, after = scorer.reduced(()), {}, before
    effects, instances = _described(data, unseen, best, scorer.share)
    return SensorFinding(
        data.sensor, float(np.sqrt(np.mean(noise**2))), before, after, effects, instances,
        unseen.time, left_over(unseen, {}), left_over(unseen, kept),
    )  # fmt: skip


class _Scorer:
    """What numbers of a sensor are worth, by stretches of each component's readings."""

    def __init__(self, data: SensorData, size: Floats) -> None:
        self._data, self._size = data, size
        self._parts = np.array_split(np.arange(len(data.time)), _STRETCHES)
        full = fit_form(data, ("scale", *data.offsets, "delay"), size)
        left = left_over(data, full.values) / size
        self.share = independent_share([c for p in self._parts for c in left[p].T])
        width = data.sensor.width
        count = np.repeat([float(len(p)) for p in self._parts], width)
        signal = np.tile(np.arange(width), len(self._parts))
        self._blocks = Blocks(np.maximum(self.share * count, 1.0), signal, np.ones(len(count)))

    def _squares(self, values: Mapping[str, float]) -> Floats:
        left = left_over(self._data, values) / self._size
        return np.concatenate([(left[p] ** 2).mean(axis=0) for p in self._parts])

    def _gain(self, fewer: Mapping[str, float], more: Mapping[str, float]) -> Gain:
        """Each number is an effect of one number, which costs half the logarithm of the data."""
        cost = 0.5 * float(np.log(self._blocks.size.sum())) - EFFECT
        prior = -cost * (len(more) - len(fewer))
        return gain(self._squares(fewer), self._squares(more), self._blocks, prior)

    def reduced(self, names: Sequence[str]) -> _Explained:
        """The fit without those numbers that are not surely worth it beside the others."""
        while True:
            fitted = fit_form(self._data, names, self._size)
            gains = {}
            for name in names:
                less = fit_form(self._data, [n for n in names if n != name], self._size)
                gains[name] = self._gain(less.values, fitted.values)
            weakest = min(names, key=lambda name: gains[name].sure, default=None)
            if weakest is None or gains[weakest].sure > 0:
                return _Explained(fitted, gains, self._gain({}, fitted.values))
            names = [n for n in names if n != weakest]


def _excess(ratio: float) -> float:
    """Amplitude beyond the noise, in units of the noise."""
    return float(np.sqrt(max(ratio**2 - 1.0, 0.0)))


def _instance(sensor: Sensor, name: str, value: float) -> EffectInstance:
    """The effect that changes a sensor so."""
    kind, _, axis = name.partition(" ")
    effect = next(n for n in effect_names() if find(n).measured_as == kind)
    parameter = "factor" if kind == "scale" else kind
    return EffectInstance(
        effect, sensor.name, {parameter: value}, {"axis": AXES[int(axis)]} if axis else {}
    )


def _possible(values: Mapping[str, float]) -> bool:
    """Whether a scale is within the bounds of what a sensor can have."""
    return 0.1 <= values.get("scale", 1.0) <= 10.0


def _described(
    data: SensorData, unseen: SensorData, best: _Explained, share: float
) -> tuple[tuple[FoundEffect, ...], tuple[EffectInstance, ...]]:
    """The effects with what they bring, and as they stand in a scene."""
    effects, instances, values = [], [], best.fitted.values
    for name, value in values.items():
        one = _instance(data.sensor, name, value)
        half = 1.96 * best.fitted.std[name] / np.sqrt(share)
        unit = {"scale": "1", "delay": "s"}.get(name.partition(" ")[0], data.sensor.unit)
        without = {key: number for key, number in values.items() if key != name}
        evidence = {
            "held_out_error_without": _rms(left_over(unseen, without)),
            "held_out_error_with": _rms(left_over(unseen, values)),
            "delta_bic": 2 * best.gains[name].total,
        }
        estimate = Estimate(value, unit, (value - half, value + half))
        instances.append(one)
        effects.append(
            FoundEffect(
                one.effect, one.target, {next(iter(one.values)): estimate}, False, evidence,
                one.options, data.sensor.unit,
            )
        )  # fmt: skip
    return tuple(effects), tuple(instances)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
