"""What a scene is made of, in words."""

from __future__ import annotations

import json

import pytest

from orbisim import load_scene
from orbisim.errors import UnknownNameError
from orbisim.scene.descriptor import describe

from .test_mjcf import EVERYTHING


def test_what_is_described() -> None:
    descriptor = load_scene(EVERYTHING).descriptor
    kinds = {entity.name: entity.kind for entity in descriptor.entities}
    assert kinds == {"world": "static", "free": "rigid_object", "arm": "robot"}
    elbow = next(j for j in descriptor.joints if j.name == "elbow")
    assert (elbow.type, elbow.child, elbow.parent) == ("hinge", "body4", "arm")
    assert (elbow.limited, elbow.range) == (True, (-1.0, 1.0))
    assert elbow.stiffness == (1.0, 0.0, 0.5)
    assert elbow.frictionloss == 0.1
    assert elbow.springref == 0.2
    ball = next(j for j in descriptor.joints if j.name == "ball")
    assert ball.damping == (0.1, 0.02, 0.0)
    position, by_tendon, passive = descriptor.actuators
    assert (position.transmission, position.target, position.ctrlrange) == (
        "joint",
        "elbow",
        (-1, 1),
    )
    assert (by_tendon.transmission, by_tendon.target, by_tendon.gear[0]) == ("tendon", "t", 2.0)
    assert passive.controls == 0
    assert descriptor.world.density == 1.2
    assert dict(descriptor.counts)["sensors"] == 2
    assert descriptor.entity("arm").mass > 0
    with pytest.raises(UnknownNameError, match="did you mean 'arm'"):
        descriptor.entity("arms")


def kinds(body: str, more: str = "") -> dict[str, str]:
    text = f"<mujoco><worldbody>{body}</worldbody>{more}</mujoco>"
    return {one.name: one.kind for one in load_scene(text).descriptor.entities}


DOOR = "<body name='door'><joint name='hinge'/><geom size='1'/><site name='knob'/></body>"


@pytest.mark.parametrize(
    ("actuator", "kind"),
    [
        ("", "articulated_object"),
        ("<actuator><motor joint='hinge'/></actuator>", "robot"),
        ("<actuator><motor site='knob'/></actuator>", "robot"),
        ("<actuator><adhesion body='door' ctrlrange='0 1'/></actuator>", "robot"),
        (
            "<tendon><fixed name='t'><joint joint='hinge' coef='1'/></fixed></tendon>"
            "<actuator><motor tendon='t'/></actuator>",
            "robot",
        ),
    ],
)
def test_who_is_a_robot(actuator: str, kind: str) -> None:
    assert kinds(DOOR, actuator)["door"] == kind


def test_what_is_welded_belongs_to_what_it_is_welded_to() -> None:
    box = "<body name='box'><freejoint/><geom size='1'/><body><geom size='1'/></body></body>"
    wall = "<body name='wall'><geom size='1'/></body>"
    assert kinds(wall + box) == {"world": "static", "box": "rigid_object"}


def test_a_flexible_object() -> None:
    cloth = (
        "<flexcomp name='cloth' type='grid' count='3 3 1' spacing='.1 .1 .1' dim='2' mass='1'"
        " radius='.01'/>"
    )
    scene = load_scene(f"<mujoco><worldbody>{cloth}</worldbody></mujoco>")
    found = [flex for entity in scene.descriptor.entities for flex in entity.flexes]
    assert sum(flex.nvert for flex in found) == 9
    assert {flex.dim for flex in found} == {2}
    assert "deformable" in {entity.kind for entity in scene.descriptor.entities}


def test_numbers_of_controls_are_those_of_their_actuator() -> None:
    """A passive actuator before others has no control, and shifts no range."""
    text = """<mujoco><worldbody><body><joint name="j"/><geom size="1"/></body></worldbody>
    <actuator><dcmotor name="passive" joint="j" input="none" motorconst="1" resistance="1"/>
    <motor name="m" joint="j" ctrlrange="-3 2" gear="7"/></actuator></mujoco>"""
    passive, motor = load_scene(text).descriptor.actuators
    assert (passive.controls, passive.ctrlrange, passive.ctrllimited) == (0, (0.0, 0.0), False)
    assert (motor.controls, motor.ctrlrange, motor.ctrllimited) == (1, (-3.0, 2.0), True)
    assert motor.gear[0] == 7.0


def test_sums_and_orders() -> None:
    scene = load_scene(EVERYTHING)
    descriptor = describe(scene.model, name="n")
    assert descriptor.name == "n"
    names = [scene.model.joint(i).name or f"joint{i}" for i in range(scene.model.njnt)]
    assert [joint.name for joint in descriptor.joints] == names
    total = sum(entity.mass for entity in descriptor.entities)
    assert total == pytest.approx(scene.model.body_mass.sum())
    assert len([g for e in descriptor.entities for g in e.geometries]) == scene.model.ngeom


def test_as_plain_data() -> None:
    plain = load_scene(EVERYTHING).descriptor.to_dict()
    again = json.loads(json.dumps(plain))
    assert again["counts"]["sensors"] == 2
    assert again["world"]["wind"] == [1.0, 0.0, 0.0]
    (tetra,) = [g for e in again["entities"] for p in e["parts"] for g in p["geometries"]
                if g["mesh"] == "tetra"]  # fmt: skip
    assert tetra["surface"]["points"] == 512


def test_an_entity_that_is_not_there() -> None:
    with pytest.raises(UnknownNameError, match="'chair'"):
        load_scene(EVERYTHING).descriptor.entity("chair")
