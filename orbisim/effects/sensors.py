"""Effects of the measurement: they act on recordings, not on the simulation."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim.effects.base import (
    AXES,
    Effect,
    EffectInstance,
    Extent,
    Parameter,
    index_of,
    is_scalar_joint,
    names_of_kind,
)
from orbisim.effects.screening import Candidate, Column, Floats, MotionRegressors, keyed
from orbisim.effects.servo_offsets import same_offsets
from orbisim.errors import InputError, UnknownNameError
from orbisim.recording.sensors import Sensor, sensors


class MeasurementEffect(Effect):
    """An effect at a joint's measured signals, at a free body's, or at a sensor."""

    kind = "sensor"
    native = False
    measurement = True

    def targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        joints = [n for n in names_of_kind(model, "joint") if is_scalar_joint(model, n)]
        sensors = [n for n in names_of_kind(model, "sensor") if n not in joints]
        return (*joints, *sensors)

    def check(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        """As `Effect.check`; the target is a joint or a sensor."""
        known = self.known_targets(model)
        if instance.target not in known:
            raise UnknownNameError("joint or sensor", instance.target, known)
        if instance.target not in names_of_kind(model, "joint"):
            axis_of(instance, _sensor(model, instance.target).width)
        self.check_values(model, instance)

    def known_targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        """Joints (free ones too) and sensors."""
        return (*names_of_kind(model, "joint"), *names_of_kind(model, "sensor"))

    def unit_of(self, model: mujoco.MjModel, target: str) -> str:
        """Unit of the measured quantity."""
        if target not in names_of_kind(model, "joint"):
            return _sensor(model, target).unit
        kind = model.jnt_type[index_of(model, "joint", target)]
        return "rad" if kind == mujoco.mjtJoint.mjJNT_HINGE else "m"


def axis_of(one: EffectInstance, width: int) -> int | None:
    """The component of a vector sensor that an effect's option `axis` names; None for all.

    Raises:
      InputError: the sensor has no such component.
    """
    if "axis" not in one.options:
        return None
    names = AXES[:width]
    if one.options["axis"] not in names or width < 2:
        raise InputError(
            f"{one.effect} at {one.target!r}: axis is {one.options['axis']!r}; "
            f"{'one of ' + ', '.join(names) if width > 1 else 'its sensor has one component only'}"
        )
    return names.index(one.options["axis"])


def _sensor(model: mujoco.MjModel, target: str) -> Sensor:
    return sensors(model)[index_of(model, "sensor", target)]


class SensorBias(MeasurementEffect):
    """The sensor reads an offset too much: measured = true + offset.

    At a joint it changes positions only; at a sensor with several components all of them, or the
    one that the option `axis` names (x, y or z).
    """

    name = "sensor_bias"
    measured_as = "offset"
    phrase = "a sensor offset"

    def equivalents(self, model: mujoco.MjModel, instance: EffectInstance) -> list[EffectInstance]:
        return same_offsets(model, instance)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("offset", self.unit_of(model, target), -100.0, 100.0, 0.02),)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        if target not in names_of_kind(view.model, "joint"):
            return []
        q, _ = _dofs(view, target)
        return [Candidate(self.name, target, (_signal(view, {q: 1.0}),), keyed("offset"))]


class SensorScale(MeasurementEffect):
    """The sensor's scale is wrong: measured = factor * true (positions and velocities).

    At a free joint the positions are scaled about the world's origin: a length scale.
    """

    name = "sensor_scale"
    rarity = -1.0
    measured_as = "scale"
    phrase = "a wrong sensor scale"

    def targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        free = [
            name
            for joint, name in enumerate(names_of_kind(model, "joint"))
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        ]
        return (*super().targets(model), *free)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("factor", "1", 0.1, 10.0, 1.0, neutral=1.0, usual=_MISSCALED),)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        if target not in names_of_kind(view.model, "joint"):
            return []
        model, nv = view.model, view.model.nv
        joint = index_of(model, "joint", target)
        adr, q = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        parts: dict[int, Floats | float] = {}
        for i in range(1 if is_scalar_joint(model, target) else 3):
            parts |= {q + i: view.qpos[:, adr + i], nv + q + i: view.qvel[:, q + i]}
        column = _signal(view, parts)
        return [Candidate(self.name, target, (column,), lambda c: {"factor": 1 + float(c[0])})]


class SensorDelay(MeasurementEffect):
    """The sensor is late: measured(t) = true(t - delay)."""

    name = "sensor_delay"
    measured_as = "delay"
    timing = True
    phrase = "a sensor delay"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("delay", "s", -1.0, 1.0, 0.01, usual=_LATE),)

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """Filters, buses and cameras take time; a reading that comes before what it reads takes
        commands that are stamped late."""
        early = _EARLY if instance.values["delay"] < 0 else 0.0
        return super().log_prior(model, instance, extent) + early

    def equivalents(self, model: mujoco.MjModel, instance: EffectInstance) -> list[EffectInstance]:
        """Where commands may be late, too, one sensor that is early is another one that is late."""
        delay = instance.values["delay"]
        others = [one for one in self.targets(model) if one != instance.target]
        return [EffectInstance(self.name, one, {"delay": -delay}) for one in others if delay < 0]

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        if target not in names_of_kind(view.model, "joint"):
            return []
        q, v = _dofs(view, target)
        column = _signal(view, {q: -view.qvel[:, q], v: -view.qacc[:, q]})
        return [Candidate(self.name, target, (column,), keyed("delay"))]


class ClockSkew(Effect):
    """The recording's clock is fast: recorded time = factor * true time.

    It is hardly ever off by percents: that is a wrong rate that somebody has written down.
    """

    name = "clock_skew"
    rarity = -2.0
    measured_as = "clock"
    kind = "recording"
    phrase = "a skewed clock"
    native = False
    measurement = True

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("factor", "1", 0.1, 10.0, 1.0, neutral=1.0, usual=_FAST, possible=_RATE),)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        """A fast clock makes every interval look longer than it was."""
        n = len(view.time) // 2
        step = (view.time[n:] - view.time[:n])[:, None]
        rate = np.concatenate([view.qvel[:n], view.qacc[:n]], axis=1)
        column = Column("state", -step * rate)
        return [Candidate(self.name, target, (column,), lambda c: {"factor": 1 + float(c[0])})]


_LATE = 0.01
"""s: drivers and filters of encoders take 1 to 10 ms, cameras and networks 20 to 50."""
_EARLY = -4.0
"""Logarithm of the odds of a sensor that is early beside one that is late."""
_MISSCALED = 0.02
"""Of analogue sensors; a wrong gear ratio or count is further off, and rarer."""
_RATE = (0.9, 1.1)
"""What is further off is another rate, and shows in how long a recording says it took."""
_FAST = 1e-3
"""Crystals are off by 1e-4 at most, host clocks that are being adjusted by 1e-3."""


def _dofs(view: MotionRegressors, joint: str) -> tuple[int, int]:
    """Columns of a joint's position and velocity in a signal."""
    q = int(view.model.jnt_dofadr[index_of(view.model, "joint", joint)])
    return q, view.model.nv + q


def _signal(view: MotionRegressors, parts: dict[int, Floats | float]) -> Column:
    values = np.zeros((len(view.time), 2 * view.model.nv))
    for index, part in parts.items():
        values[:, index] = part
    return Column("signal", values)
