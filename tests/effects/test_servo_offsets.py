"""Offsets that look the same at a position servo."""

from __future__ import annotations

import pytest

import orbisim
from orbisim.effects import EffectInstance, find
from orbisim.effects.servo_offsets import same_offsets

SERVO = """<mujoco><worldbody>
<body name="ball"><freejoint name="ball"/><geom name="ball" size=".1"/></body>
<body name="carriage"><joint name="x" type="slide" axis="1 0 0"/><geom size=".1"/>
<body name="hand"><joint name="y" type="slide" axis="0 1 0"/><geom size=".1"/></body></body>
</worldbody><actuator><position name="pull" joint="y" kp="50" gear="2"/></actuator></mujoco>"""


def test_offsets_at_a_servo_look_the_same() -> None:
    """A servo of 50 N/m with a gear of 2, whose command is in units of the gear's output."""
    model = orbisim.load_scene(SERVO).model
    bias = EffectInstance("sensor_bias", "y", {"offset": 0.01})
    (push,) = find("sensor_bias").equivalents(model, bias)
    assert (push.effect, push.target) == ("torque_bias", "pull")
    assert push.values["offset"] == pytest.approx(50 * 2 * 0.01)
    (back,) = find("torque_bias").equivalents(model, push)
    assert (back.effect, back.target) == ("sensor_bias", "y")
    assert back.values["offset"] == pytest.approx(0.01)
    parts = {"magnitude": 2.0, "x": 0.0, "y": 2.0, "z": 0.0}
    both = find("constant_force").equivalents(
        model, EffectInstance("constant_force", "hand", parts)
    )
    assert {e.effect: e.values["offset"] for e in both} == pytest.approx(
        {"torque_bias": 1.0, "sensor_bias": 0.01}
    )
    parts = {"magnitude": 2.0, "x": 2.0, "y": 0.0, "z": 0.0}
    force = EffectInstance("constant_force", "hand", parts)
    assert same_offsets(model, force) == []  # no servo there
    assert same_offsets(model, EffectInstance("sensor_bias", "x", {"offset": 0.01})) == []
    drag = EffectInstance("linear_drag", "hand", {"coefficient": 1.0})
    assert same_offsets(model, drag) == find("linear_drag").equivalents(model, drag) == []
