"""Units of parameters follow from what the target is."""

import pytest

from orbisim.effects import EffectInstance, find

from .transmissions import TRANSMISSIONS


@pytest.mark.parametrize("effect", ["torque_bias", "torque_saturation"])
def test_forces_of_actuators(effect: str) -> None:
    turning = {"hinge", "angle", "wheel", "spin"}
    for number in range(TRANSMISSIONS.nu):
        name = TRANSMISSIONS.actuator(number).name
        (parameter,) = find(effect).parameters(TRANSMISSIONS, name)
        assert parameter.unit == ("N*m" if name in turning else "N"), name


def test_periodic_disturbance() -> None:
    effect = find("periodic_disturbance")
    units = {t: effect.parameters(TRANSMISSIONS, t)[0].unit for t in ("hinge", "slide", "drone")}
    assert units == {"hinge": "N*m", "slide": "N", "drone": "N"}


@pytest.mark.parametrize(
    ("target", "other", "by", "unit"),
    [
        ("hinge", "slide", "torque", "m"),
        ("slide", "hinge", "torque", "1/m"),
        ("hinge", "slide", "position", "N*m/m"),
        ("slide", "hinge", "velocity", "N*s/rad"),
    ],
)
def test_joint_coupling(target: str, other: str, by: str, unit: str) -> None:
    coupling = EffectInstance(
        "joint_coupling", target, {"coefficient": 1.0}, {"other": other, "by": by}
    )
    assert find("joint_coupling").units(TRANSMISSIONS, coupling) == {"coefficient": unit}
