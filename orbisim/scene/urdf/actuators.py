"""Actuators from transmissions and joint limits, on request."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import mujoco

from orbisim.scene.reading import Unsupported
from orbisim.scene.urdf.joints import ONE_AXIS
from orbisim.scene.urdf.model import Joint, Robot, Transmission
from orbisim.scene.urdf.options import UrdfOptions


class Actuators:
    """Adds one actuator for each joint that is to be driven."""

    def __init__(self, spec: mujoco.MjSpec, options: UrdfOptions) -> None:
        self._spec, self._options = spec, options
        self._names: set[str] = set()
        self.warnings: list[str] = []
        self.unsupported: list[Unsupported] = []

    def add(self, robot: Robot) -> None:
        """Makes the actuators, or says what was not made."""
        kind = self._options.actuators
        if kind is None:
            self._list_unused(robot.transmissions)
            self._say_that_nothing_drives(robot)
            return
        driven = [t for t in self._transmissions(robot) if self._drives(robot.joints[t.joint], t)]
        for transmission in driven:
            self._add_one(kind, transmission, robot.joints[transmission.joint])
        if not driven:
            every = self._options.actuate == "all"
            self.warnings.append(
                "no actuators were made: no joint moves about one axis"
                if every
                else "no actuators were made: the document has no transmission of a joint with one "
                "axis; --actuators on the command line, actuate='all' in Python, drives every such "
                "joint"
            )
        elif kind != "motor":
            unit = {"position": "position_gain", "velocity": "velocity_gain"}[kind]
            self.warnings.append(
                f"{len(driven)} {kind} actuators have the gain {getattr(self._options, unit):g}, "
                f"which URDF does not give; say it behind the file's name, 'x.urdf?{unit}=...' "
                f"(in Python load_scene(..., {unit}=...))"
            )

    def _say_that_nothing_drives(self, robot: Robot) -> None:
        moving = [joint for joint in robot.joints.values() if joint.type in ONE_AXIS]
        if moving:
            self.warnings.append(
                f"{len(moving)} joints move and nothing drives them: controls do nothing; "
                "--actuators motor, position or velocity drives them (in Python actuators=..., "
                "and actuate='all' for joints without a transmission)"
            )

    def _transmissions(self, robot: Robot) -> list[Transmission]:
        """Those of the document, and on request direct drives for the other joints."""
        found = list(robot.transmissions)
        if self._options.actuate == "all":
            known = {transmission.joint for transmission in found}
            found += [
                Transmission(joint.label, joint.name, joint.name, 1.0)
                for joint in robot.joints.values()
                if joint.name not in known and joint.type in ONE_AXIS and joint.mimic is None
            ]
        return found

    def _drives(self, joint: Joint, transmission: Transmission) -> bool:
        if joint.type in ONE_AXIS:
            return True
        self.unsupported.append(
            Unsupported(
                transmission.label, f"transmission of a {joint.type} joint", "no actuator is made"
            )
        )
        return False

    def _add_one(self, kind: str, transmission: Transmission, joint: Joint) -> None:
        """Lengths and forces are the actuator's own: the joint's through the reduction."""
        gear = transmission.reduction
        actuator = self._spec.add_actuator(
            name=self._free_name(transmission.actuator),
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=joint.name,
        )
        actuator.gear[0] = gear
        effort = abs(joint.effort or 0.0) / abs(gear)
        if effort > 0.0:
            actuator.forcelimited, actuator.forcerange = True, (-effort, effort)
        span = _SPANS[kind](joint, gear, effort)
        if span is not None:
            actuator.ctrllimited, actuator.ctrlrange = True, span
        if kind == "position":
            actuator.set_to_position(kp=self._options.position_gain, dampratio=1.0)
        elif kind == "velocity":
            actuator.set_to_velocity(kv=self._options.velocity_gain)
        else:
            actuator.set_to_motor()

    def _free_name(self, name: str) -> str:
        candidate, number = name, 1
        while candidate in self._names:
            number += 1
            candidate = f"{name}_{number}"
        self._names.add(candidate)
        return candidate

    def _list_unused(self, transmissions: Sequence[Transmission]) -> None:
        if transmissions:
            first = transmissions[0].label
            more = f" and {len(transmissions) - 1} more" if len(transmissions) > 1 else ""
            self.unsupported.append(
                Unsupported(
                    first + more,
                    "<transmission>",
                    "no actuators are made; --actuators motor, position or velocity makes them (in "
                    "Python actuators=...)",
                )
            )


Span = tuple[float, float] | None


def _force_span(joint: Joint, gear: float, effort: float) -> Span:
    return (-effort, effort) if effort > 0.0 else None


def _position_span(joint: Joint, gear: float, effort: float) -> Span:
    if joint.lower is None or joint.upper is None or joint.lower == joint.upper:
        return None
    ends = sorted((joint.lower * gear, joint.upper * gear))
    return ends[0], ends[1]


def _velocity_span(joint: Joint, gear: float, effort: float) -> Span:
    speed = abs((joint.velocity or 0.0) * gear)
    return (-speed, speed) if speed > 0.0 else None


_SPANS: Mapping[str, Callable[[Joint, float, float], Span]] = {
    "motor": _force_span,
    "position": _position_span,
    "velocity": _velocity_span,
}
