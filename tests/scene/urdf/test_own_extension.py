"""`<orbisim>` in URDF: springs, effects, links that do not touch each other."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import load_scene
from orbisim.effects import carried_effects
from orbisim.errors import OrbiSimError, SceneError

LINK = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/>
  </inertial><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="0" velocity="0"/></joint>"""
LATCH = """<effect name="latch" target="hinge"><parameter name="force" value="20"/>
  <parameter name="position" value="0"/><parameter name="width" value="0.02"/>
  <parameter name="threshold" value="0.5"/><option name="other" value="handle"/></effect>"""


def robot(extension: str) -> str:
    links = "".join(LINK.format(name) for name in ("base", "leaf", "lever"))
    joints = JOINT.format("hinge", "revolute", "base", "leaf") + JOINT.format(
        "handle", "revolute", "leaf", "lever"
    )
    return f'<robot name="gate">{links}{joints}<orbisim>{extension}</orbisim></robot>'


def test_what_urdf_cannot_say_of_a_joint() -> None:
    spring = '<joint name="handle" stiffness="0.8" springref="0.2" armature="0.01"'
    rigid = 'solreffriction="0.004 1" solimpfriction="0.99 0.99 0.001 0.5 2"'
    model = load_scene(robot(f"{spring} {rigid}/>")).model
    joint = model.joint("handle")
    assert float(joint.stiffness[0]) == 0.8 and float(model.joint("hinge").stiffness[0]) == 0.0
    assert model.qpos_spring[int(joint.qposadr[0])] == 0.2
    dof = int(joint.dofadr[0])
    assert model.dof_armature[dof] == 0.01
    np.testing.assert_array_equal(model.dof_solref[dof], [0.004, 1.0])
    assert model.dof_solimp[dof][0] == 0.99


def test_effects_are_carried() -> None:
    [latch] = carried_effects(load_scene(robot(LATCH)).model)
    assert (latch.effect, latch.target, latch.options["other"]) == ("latch", "hinge", "handle")
    assert latch.values["force"] == 20.0


def test_links_that_do_not_touch_each_other() -> None:
    assert load_scene(robot("")).model.geom_conaffinity.any()
    assert not load_scene(robot('<collision self="false"/>')).model.geom_conaffinity.any()


def test_an_element_that_is_not_known_is_listed() -> None:
    [left] = load_scene(robot("<magnet/>")).unsupported
    assert "magnet" in str(left)


@pytest.mark.parametrize(
    ("extension", "match"),
    [
        ('<joint name="elbow" stiffness="1"/>', "elbow"),
        ('<joint name="hinge" colour="1"/>', "colour"),
        ('<joint name="hinge" stiffness="much"/>', "one finite number"),
        ('<joint name="hinge" solreffriction="1"/>', "2 finite numbers"),
        ('<joint stiffness="1"/>', "name"),
        ('<effect name="latch"/>', "target"),
        (LATCH.replace('value="20"', 'value="nan"'), "finite"),
        (LATCH.replace('target="hinge"', 'target="gate"'), "gate"),
        (LATCH.replace('name="latch"', 'name="glue"'), "glue"),
        (LATCH.replace('value="handle"', 'value="knob"'), "knob"),
        ('<collision self="maybe"/>', "true or false"),
    ],
)
def test_what_is_refused(extension: str, match: str) -> None:
    with pytest.raises(OrbiSimError, match=match) as caught:
        load_scene(robot(extension))
    assert isinstance(caught.value, SceneError)
