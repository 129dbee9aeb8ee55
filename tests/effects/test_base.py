"""What an effect is: parameters, instances, names of targets."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from orbisim import Scene, load_scene
from orbisim.effects import EffectInstance, Hook, Parameter, find
from orbisim.effects.base import (
    actuator_unit,
    cross,
    index_of,
    is_scalar_joint,
    joint_unit,
    joints_of,
    names_of_kind,
    spec_element,
)
from orbisim.effects.running import HookRunner
from orbisim.errors import InputError, UnknownNameError

from .motion import Motion
from .transmissions import TRANSMISSIONS


def test_json_round_trip() -> None:
    instance = EffectInstance("joint_coupling", "a", {"coefficient": 0.1}, {"other": "b"})
    assert EffectInstance.from_json(json.loads(json.dumps(instance.to_json()))) == instance


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"effect": "a", "target": "b"},
        {"effect": "a", "target": "b", "parameters": {"x": "one"}},
    ],
)
def test_what_is_no_effect_is_refused(data: dict) -> None:
    with pytest.raises(InputError, match="not an effect"):
        EffectInstance.from_json(data)


def test_other_values_of_an_instance() -> None:
    one = EffectInstance("e", "t", {"a": 1.0, "b": 2.0})
    assert one.replace(b=3.0).values == {"a": 1.0, "b": 3.0}
    assert str(one) == "e(t: a=1, b=2)"


def test_bounds_hold_their_ends() -> None:
    parameter = Parameter("width", "m", 0.5, 2.0, 1.0)
    assert [parameter.check("e", "t", value) for value in (0.5, 2)] == [0.5, 2.0]
    for value in (0.49, 2.01, math.nan, math.inf):
        with pytest.raises(InputError, match=r"e at 't': width is .* within 0\.5 to 2 m"):
            parameter.check("e", "t", value)


NAMELESS = """
<mujoco><worldbody>
  <body><joint/><geom size=".1"/>
    <body name="named"><joint name="slide" type="slide"/><geom size=".1"/></body></body>
  <body name="free"><freejoint name="root"/><geom size=".1"/></body>
</worldbody></mujoco>
"""


def test_elements_without_a_name_are_found_by_number() -> None:
    scene = load_scene(NAMELESS)
    assert names_of_kind(scene.model, "joint") == ("joint0", "slide", "root")
    assert names_of_kind(scene.model, "world") == ("world",)
    assert index_of(scene.model, "body", "body1") == 1
    spec = scene.spec
    spec_element(spec, "joint", "joint0").armature = 0.5
    spec_element(spec, "body", "body1").gravcomp = 0.25
    model = spec.compile()
    assert model.dof_armature[0] == 0.5
    assert model.body_gravcomp[1] == 0.25
    for name in ("joint1", "joint9", "knee"):
        with pytest.raises(UnknownNameError, match=name):
            spec_element(spec, "joint", name)
    with pytest.raises(UnknownNameError):
        index_of(scene.model, "joint", "joint1")


def test_units_of_joints() -> None:
    model = load_scene(NAMELESS).model
    assert joint_unit(model, "joint0", "rad", "m") == "rad"
    assert joint_unit(model, "slide", "rad", "m") == "m"
    assert [is_scalar_joint(model, n) for n in ("joint0", "slide", "root")] == [True, True, False]


def test_units_of_actuators() -> None:
    turning = {"hinge", "angle", "wheel", "spin"}
    for number in range(TRANSMISSIONS.nu):
        name = TRANSMISSIONS.actuator(number).name
        assert actuator_unit(TRANSMISSIONS, name) == ("N*m" if name in turning else "N"), name


def test_velocities_of_bodies_are_mujocos(motion: Motion) -> None:
    """From `cvel`, which is that of the tree's centre of mass."""

    class Reads(Hook):
        derived = frozenset({"cvel", "xipos", "subtree_com"})

    applied = {"qfrc_applied": np.zeros(0), "xfrc_applied": np.zeros(0)}
    runner = HookRunner(motion.model, [Reads({})])
    inputs = runner.inputs(lambda n: getattr(motion, n), motion.ctrl, applied, {})
    for body in range(1, motion.model.nbody):
        spin, velocity = inputs.body_velocity(body)
        expected = motion.body_motion(body)
        np.testing.assert_allclose(spin, expected.spin, atol=1e-12)
        np.testing.assert_allclose(velocity, expected.velocity, atol=1e-12)


def test_what_an_effect_lacks_is_said(scene: Scene) -> None:
    one = EffectInstance("coulomb_friction", "elbow", {})
    with pytest.raises(InputError, match="lacks torque"):
        find("coulomb_friction").check(scene.model, one)
    with pytest.raises(InputError, match="needs no hook"):
        find("coulomb_friction").hook(scene.model, one)
    with pytest.raises(InputError, match="has no native form"):
        find("magnus").edit(scene.spec, one)


def test_a_cross_product_is_numpys() -> None:
    one, other = np.random.default_rng(0).standard_normal((2, 5, 3))
    np.testing.assert_array_equal(cross(one, other), np.cross(one, other))


def test_joints_at_which_something_is() -> None:
    model = load_scene(
        """<mujoco><worldbody>
          <body name="sled"><joint name="x" type="slide"/><joint name="turn"/><geom size="1"/>
            <body name="arm"><joint name="elbow" pos="0 0 1"/><geom size="1"/></body>
            <body name="lamp"><geom size="1"/></body></body></worldbody>
        <tendon><fixed name="rope"><joint joint="x" coef="1"/></fixed></tendon>
        <actuator><motor name="motor" joint="elbow"/><motor name="winch" tendon="rope"/></actuator>
        </mujoco>"""
    ).model
    assert joints_of(model, "joint", "turn") == joints_of(model, "sensor", "turn") == ("turn",)
    assert joints_of(model, "sensor", "an accelerometer") == ()
    assert joints_of(model, "actuator", "motor") == ("elbow",)
    assert joints_of(model, "actuator", "winch") == ()
    assert joints_of(model, "body", "sled") == ("x", "turn")
    assert joints_of(model, "body", "lamp") == joints_of(model, "world", "world") == ()
