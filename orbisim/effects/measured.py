"""What effects of the measurement do to a recording, and how to undo it.

A joint or sensor reads s x(t - d) + b; then the clock's factor stretches the time stamps. Offsets
change positions only; controls, torques and body poses are left as they are.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from orbisim.effects.base import EffectInstance
from orbisim.effects.catalogue import find
from orbisim.errors import InputError
from orbisim.recording.joints import Joint, Kind, by_name
from orbisim.recording.recording import Recording

if TYPE_CHECKING:
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


def _places(recording: Recording, scene: Scene, target: str) -> list[tuple[str, slice]]:
    """Signals and their columns that a target is read by; positions first.

    Raises:
      InputError: it is not recorded.
    """
    joint = by_name(scene.model).get(target)
    found = _of_joint(recording, joint) if joint is not None else []
    if joint is None and f"sensor/{target}" in recording.signals:
        found = [(f"sensor/{target}", slice(None))]
    if not found:
        raise InputError(f"{target!r} is not recorded in {recording.source!r}")
    return found


def _of_joint(recording: Recording, joint: Joint) -> list[tuple[str, slice]]:
    width = {Kind.FREE: 3, Kind.BALL: 0}.get(joint.kind, 1)
    found: list[tuple[str, slice]] = []
    for kind, own in (("qpos", joint.q), ("qvel", joint.v)):
        if f"{kind}/{joint.name}" in recording.signals:
            found.append((f"{kind}/{joint.name}", slice(0, width)))
        elif kind in recording.signals:
            found.append((kind, slice(own.start, own.start + width)))
    return found


def _changed(recording: Recording, name: str, columns: slice, values: Floats) -> Recording:
    signal = np.array(recording[name])
    matrix = signal.reshape(len(signal), -1)  # a view: signals are contiguous
    matrix[:, columns] = values
    return recording.replace(signals={**recording.signals, name: signal})


def _columns(recording: Recording, name: str, columns: slice) -> Floats:
    return recording[name].reshape(len(recording), -1)[:, columns]


# -- the three maps --------------------------------------------------------------------------------


def _scaled(recording: Recording, one: EffectInstance, scene: Scene, factor: float) -> Recording:
    if one.effect != "sensor_scale":
        return recording
    for name, columns in _places(recording, scene, one.target):
        values = factor * _columns(recording, name, columns)
        recording = _changed(recording, name, columns, values)
    return recording


def _offset(recording: Recording, one: EffectInstance, scene: Scene, offset: float) -> Recording:
    if one.effect != "sensor_bias":
        return recording
    for name, columns in _places(recording, scene, one.target):
        if not name.startswith("qvel"):
            values = _columns(recording, name, columns) + offset
            recording = _changed(recording, name, columns, values)
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
    for target, delay in delays.items():
        at = np.clip(result.time - delay, time[0], time[-1])
        places = _places(recording, scene, target)
        for name, columns in places:
            values = _at(recording, name, columns, places, at)
            result = _changed(result, name, columns, values)
    return result


def _at(
    recording: Recording,
    name: str,
    columns: slice,
    places: list[tuple[str, slice]],
    at: Floats,
) -> Floats:
    """A signal at other times [N]; exact where a time is that of a sample."""
    values = _columns(recording, name, columns)
    speeds = [_columns(recording, *place) for place in places if place[0].startswith("qvel")]
    if name.startswith("qpos") and speeds and np.isfinite(speeds[0]).all():
        curve = CubicHermiteSpline(recording.time, values, speeds[0], axis=0)
    else:
        curve = CubicSpline(recording.time, values, axis=0)
    return np.asarray(curve(at), np.float64)
