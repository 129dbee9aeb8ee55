"""Units of parameters follow from what the target is."""

import mujoco
import pytest

from orbisim.effects import EffectInstance, find

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0"/><geom size=".1"/>
      <body name="pole"><joint name="hinge" axis="0 1 0"/><geom size=".1"/>
        <site name="tip" pos="0 0 1"/></body>
    </body>
    <body name="drone"><freejoint name="free"/><geom size=".1"/><site name="hub"/></body>
  </worldbody>
  <tendon>
    <fixed name="angle"><joint joint="hinge" coef="1"/></fixed>
    <fixed name="mixed"><joint joint="hinge" coef="1"/><joint joint="slide" coef="1"/></fixed>
    <spatial name="cable"><site site="tip"/><site site="hub"/></spatial>
  </tendon>
  <actuator>
    <motor name="hinge" joint="hinge"/>
    <motor name="slide" joint="slide"/>
    <motor name="angle" tendon="angle"/>
    <motor name="mixed" tendon="mixed"/>
    <motor name="cable" tendon="cable"/>
    <motor name="rotor" site="hub" gear="0 0 1 0 0 0.1"/>
    <motor name="wheel" site="hub" gear="0 0 0 0 0 1"/>
    <motor name="spin" joint="free" gear="0 0 0 1 0 0"/>
  </actuator>
</mujoco>
""")


@pytest.mark.parametrize("effect", ["torque_bias", "torque_saturation"])
def test_forces_of_actuators(effect: str) -> None:
    turning = {"hinge", "angle", "wheel", "spin"}
    for number in range(MODEL.nu):
        name = MODEL.actuator(number).name
        (parameter,) = find(effect).parameters(MODEL, name)
        assert parameter.unit == ("N*m" if name in turning else "N"), name


def test_periodic_disturbance() -> None:
    effect = find("periodic_disturbance")
    units = {t: effect.parameters(MODEL, t)[0].unit for t in ("hinge", "slide", "drone")}
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
    assert find("joint_coupling").units(MODEL, coupling) == {"coefficient": unit}
