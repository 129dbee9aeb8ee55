"""Effects of the measurement: they act on recordings, not on the simulation."""

from __future__ import annotations

import mujoco

from orbisim.effects.base import Effect, Parameter, index_of, is_scalar_joint, names_of_kind


class MeasurementEffect(Effect):
    """An effect at a joint's measured signals, at a free body's, or at a sensor."""

    kind = "sensor"
    native = False
    measurement = True

    def targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        joints = [n for n in names_of_kind(model, "joint") if is_scalar_joint(model, n)]
        sensors = [n for n in names_of_kind(model, "sensor") if n not in joints]
        return (*joints, *sensors)

    def check(self, model: mujoco.MjModel, instance: object) -> None:
        """As `Effect.check`; the target is a joint or a sensor."""
        from orbisim.effects.base import EffectInstance
        from orbisim.errors import UnknownNameError

        assert isinstance(instance, EffectInstance)
        known = self.known_targets(model)
        if instance.target not in known:
            raise UnknownNameError("joint or sensor", instance.target, known)
        for parameter in self.parameters(model, instance.target):
            parameter.check(self.name, instance.target, instance.values[parameter.name])

    def known_targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        """Joints (free ones too) and sensors."""
        return (*names_of_kind(model, "joint"), *names_of_kind(model, "sensor"))

    def unit_of(self, model: mujoco.MjModel, target: str) -> str:
        """Unit of the measured quantity."""
        if target not in names_of_kind(model, "joint"):
            return "1"
        kind = model.jnt_type[index_of(model, "joint", target)]
        return "rad" if kind == mujoco.mjtJoint.mjJNT_HINGE else "m"


class SensorBias(MeasurementEffect):
    """The sensor reads an offset too much: measured = true + offset (positions only)."""

    name = "sensor_bias"
    phrase = "a sensor offset"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("offset", self.unit_of(model, target), -100.0, 100.0, 0.02),)


class SensorScale(MeasurementEffect):
    """The sensor's scale is wrong: measured = factor * true (positions and velocities).

    At a free joint the positions are scaled about the world's origin: a length scale.
    """

    name = "sensor_scale"
    phrase = "a wrong sensor scale"

    def targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        free = [
            name
            for joint, name in enumerate(names_of_kind(model, "joint"))
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        ]
        return (*super().targets(model), *free)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("factor", "1", 0.1, 10.0, 1.0),)


class SensorDelay(MeasurementEffect):
    """The sensor is late: measured(t) = true(t - delay)."""

    name = "sensor_delay"
    phrase = "a sensor delay"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("delay", "s", -1.0, 1.0, 0.01),)


class ClockSkew(Effect):
    """The recording's clock is fast: recorded time = factor * true time."""

    name = "clock_skew"
    kind = "recording"
    phrase = "a skewed clock"
    native = False
    measurement = True

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("factor", "1", 0.1, 10.0, 1.0),)
