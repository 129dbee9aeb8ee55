"""What effects of the measurement do to a recording, and how to undo it.

A joint or sensor reads s x(t - d) + b; then the clock's factor stretches the time stamps. Offsets
change positions only; controls, torques and body poses are left as they are.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from orbisim.effects.base import EffectInstance
from orbisim.effects.catalogue import find
from orbisim.effects.sensors import axis_of
from orbisim.errors import InputError
from orbisim.recording.joints import Joint, Kind, by_name
from orbisim.recording.recording import Recording
from orbisim.recording.sensors import Sensor, reads_state, sensors
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]

_SLACK = 1e-9
"""Part of the duration by which a sample may lie outside the recording."""


def distort(recording: Recording, instances: Iterable[EffectInstance], scene: Scene) -> Recording:
    """The recording as a measurement with these effects gives it; other effects are ignored.

    Delayed positions lie on a cubic curve through the samples (with the recorded velocities as its
    slopes, where there are any). Samples that would need values from outside the recording are
    left out.

    Args:
      recording: as a perfect measurement gives it.
      instances: effects; only those of the measurement act.
      scene: whose joints and sensors they name.

    Raises:
      InputError: an effect does not fit the scene, or the target is not recorded, or nothing is
        left of the recording.
    """
    found = _measuring(instances, scene)
    result = _shifted(recording, found, scene, 1.0)
    for one in found:
        result = _scaled(result, one, scene, one.values.get("factor", 1.0))
    for one in found:
        result = _offset(result, one, scene, one.values.get("offset", 0.0))
    return result.replace(time=result.time * _clock(found))


def correct(recording: Recording, instances: Iterable[EffectInstance], scene: Scene) -> Recording:
    """The inverse of `distort`: what a perfect measurement would have recorded.

    Raises:
      InputError: as `distort`.
    """
    found = _measuring(instances, scene)
    result = recording.replace(time=recording.time / _clock(found))
    for one in found:
        result = _offset(result, one, scene, -one.values.get("offset", 0.0))
    for one in found:
        result = _scaled(result, one, scene, 1.0 / one.values.get("factor", 1.0))
    return _shifted(result, found, scene, -1.0)


def longest_delay(instances: Iterable[EffectInstance]) -> float:
    """The largest delay or advance of a sensor among the effects, s."""
    delays = [abs(e.values["delay"]) for e in instances if e.effect == "sensor_delay"]
    return max(delays, default=0.0)


def _measuring(instances: Iterable[EffectInstance], scene: Scene) -> list[EffectInstance]:
    found = [one for one in instances if find(one.effect).measurement]
    for one in found:
        find(one.effect).check(scene.model, one)
    return found


def _clock(instances: Iterable[EffectInstance]) -> float:
    factors = [e.values["factor"] for e in instances if e.effect == "clock_skew"]
    return float(np.prod(factors)) if factors else 1.0


# -- the signals of a target -----------------------------------------------------------------------


class Place(NamedTuple):
    """Columns of a signal. rate: whether they hold velocities."""

    signal: str
    columns: slice
    rate: bool


def _places(recording: Recording, scene: Scene, one: EffectInstance) -> list[Place]:
    """Where an effect's target is read; positions first.

    A joint that is not recorded under its own name is read by its sensors.

    Raises:
      InputError: it is not recorded.
    """
    joint = by_name(scene.model).get(one.target)
    if joint is None:
        found = _of_sensor(recording, scene, one)
    else:
        found = _of_joint(recording, joint) or _of_body(recording, scene, joint)
    if joint is not None and not found:
        found = _of_joint_sensors(recording, scene, joint)
    if not found:
        raise InputError(f"{one.target!r} is not recorded in {recording.source!r}")
    return found


def _of_joint(recording: Recording, joint: Joint) -> list[Place]:
    width = {Kind.FREE: 3, Kind.BALL: 0}.get(joint.kind, 1)
    found: list[Place] = []
    for kind, own in (("qpos", joint.q), ("qvel", joint.v)):
        if f"{kind}/{joint.name}" in recording.signals:
            found.append(Place(f"{kind}/{joint.name}", slice(0, width), kind == "qvel"))
        elif kind in recording.signals:
            found.append(Place(kind, slice(own.start, own.start + width), kind == "qvel"))
    return found


def _of_body(recording: Recording, scene: Scene, joint: Joint) -> list[Place]:
    """A free joint that is known by where its body is."""
    signal = f"xpos/{scene.model.body(joint.body).name}"
    if joint.kind is not Kind.FREE or signal not in recording.signals:
        return []
    return [Place(signal, slice(0, 3), False)]


def _of_joint_sensors(recording: Recording, scene: Scene, joint: Joint) -> list[Place]:
    found: list[Place] = []
    for sensor in sensors(scene.model):
        reads = reads_state(scene.model, sensor)
        if reads in (("qpos", joint.id), ("qvel", joint.id)) and sensor.width == 1:
            place = _signal_of(recording, sensor)
            if place is not None:
                found.append(place._replace(rate=reads[0] == "qvel"))
    return sorted(found, key=lambda place: place.rate)


def _of_sensor(recording: Recording, scene: Scene, one: EffectInstance) -> list[Place]:
    sensor = next((s for s in sensors(scene.model) if s.name == one.target), None)
    place = None if sensor is None else _signal_of(recording, sensor)
    if place is None or sensor is None:
        return []
    axis = axis_of(one, sensor.width)
    first = place.columns.start
    columns = place.columns if axis is None else slice(first + axis, first + axis + 1)
    return [place._replace(columns=columns)]


def _signal_of(recording: Recording, sensor: Sensor) -> Place | None:
    if f"sensor/{sensor.name}" in recording.signals:
        return Place(f"sensor/{sensor.name}", slice(0, sensor.width), False)
    return Place("sensordata", sensor.place, False) if "sensordata" in recording.signals else None


def _changed(recording: Recording, place: Place, values: Floats) -> Recording:
    signal = np.array(recording[place.signal])
    matrix = signal.reshape(len(signal), -1)  # a view: signals are contiguous
    matrix[:, place.columns] = values
    return recording.replace(signals={**recording.signals, place.signal: signal})


def _columns(recording: Recording, place: Place) -> Floats:
    return recording[place.signal].reshape(len(recording), -1)[:, place.columns]


# -- the three maps --------------------------------------------------------------------------------


def _scaled(recording: Recording, one: EffectInstance, scene: Scene, factor: float) -> Recording:
    if one.effect != "sensor_scale":
        return recording
    for place in _places(recording, scene, one):
        values = factor * _columns(recording, place)
        recording = _changed(recording, place, values)
    return recording


def _offset(recording: Recording, one: EffectInstance, scene: Scene, offset: float) -> Recording:
    if one.effect != "sensor_bias":
        return recording
    for place in _places(recording, scene, one):
        if not place.rate:
            values = _columns(recording, place) + offset
            recording = _changed(recording, place, values)
    return recording


def _shifted(
    recording: Recording, instances: list[EffectInstance], scene: Scene, sign: float
) -> Recording:
    """Every delayed signal at t - sign * delay, and the rows for which that is known."""
    delays: dict[str, float] = {}
    for one in instances:
        if one.effect == "sensor_delay":
            delays[one.target] = delays.get(one.target, 0.0) + sign * one.values["delay"]
    if not delays:
        return recording
    time = recording.time
    slack = _SLACK * recording.duration
    low, high = time[0] + max(0.0, *delays.values()), time[-1] + min(0.0, *delays.values())
    kept = np.flatnonzero((time >= low - slack) & (time <= high + slack))
    if not len(kept):
        raise InputError(f"{recording.source!r} is shorter than the delay of its sensors")
    result = recording.rows(kept)
    for one in (EffectInstance("sensor_delay", target, {}) for target in delays):
        at = np.clip(result.time - delays[one.target], time[0], time[-1])
        places = _places(recording, scene, one)
        for place in places:
            result = _changed(result, place, _at(recording, place, places, at))
    return result


def _at(recording: Recording, place: Place, places: list[Place], at: Floats) -> Floats:
    """A signal at other times [N]; exact where a time is that of a sample."""
    values = _columns(recording, place)
    speeds = [_columns(recording, other) for other in places if other.rate]
    if not place.rate and speeds and np.isfinite(speeds[0]).all():
        curve = CubicHermiteSpline(recording.time, values, speeds[0], axis=0)
    else:
        known = np.isfinite(values).all(axis=1)
        curve = CubicSpline(recording.time[known], values[known], axis=0)
    return np.asarray(curve(at), np.float64)
