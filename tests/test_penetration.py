"""Penetration: how deep, between which bodies, and only where the scene lets them touch."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import load_scene
from orbisim.penetration import group_of, groups, penetration
from orbisim.scene import Scene

BOX = "<geom type='box' size='.05 .05 .05'{}/>"


def scene(bodies: str, rest: str = "") -> Scene:
    return load_scene(
        f"<mujoco><worldbody><geom name='floor' type='plane' size='1 1 .1'/>{bodies}</worldbody>"
        f"{rest}</mujoco>"
    )


def box(name: str, x: float, z: float, masks: str = "") -> str:
    return f"<body name='{name}' pos='{x} 0 {z}'><freejoint/>{BOX.format(masks)}</body>"


def test_depths_are_those_of_the_geometry() -> None:
    """One box 2 mm in the floor, another 3 mm in the first, seen from states of two worlds."""
    two = scene(box("one", 0, 1) + box("other", 5, 1))
    qpos = np.tile(two.model.qpos0, (2, 3, 1))
    qpos[0, 1, 2] = 0.048
    qpos[1, 2, [0, 7]] = 0.0, 0.097
    qpos[1, 0, 4] = np.nan
    found = penetration(two, qpos)
    assert set(found.depth) == {"object-object", "object-world"}
    expected = np.zeros((2, 3))
    expected[1, 0] = np.nan
    expected[0, 1] = 0.002
    np.testing.assert_allclose(found.depth["object-world"], expected, atol=1e-9)
    expected[0, 1], expected[1, 2] = 0.0, 0.003
    np.testing.assert_allclose(found.depth["object-object"], expected, atol=1e-9)
    ground, between = found.deepest["object-world"], found.deepest["object-object"]
    assert ground is not None and between is not None
    assert ground[1:] == (0, 1, ("floor", "one"))
    assert between.depth == pytest.approx(0.003)
    assert between[1:] == (1, 2, ("one", "other"))


def test_nothing_overlaps_where_nothing_does() -> None:
    one = scene(box("one", 0, 1))
    found = penetration(one, one.model.qpos0[None, None])
    assert found.depth["object-world"].tolist() == [[0.0]]
    assert found.deepest == {"object-world": None}


ARM = "<body name='arm'><joint name='j'/>" + BOX.format("") + "{}</body>"
MOTOR = "<actuator><motor joint='j'/></actuator>"


@pytest.mark.parametrize(
    ("bodies", "rest", "expected"),
    [
        (box("one", 0, 1), "", {"object-world"}),
        (box("one", 0, 1, " contype='0' conaffinity='0'"), "", set()),
        (box("one", 0, 1) + box("two", 1, 1), "", {"object-object", "object-world"}),
        (
            box("one", 0, 1) + box("two", 1, 1),
            "<contact><exclude body1='one' body2='two'/></contact>",
            {"object-world"},
        ),
        (ARM.format(""), MOTOR, {"robot-world"}),
        (ARM.format(""), "", {"object-world"}),  # nothing drives it: an articulated object
        (
            ARM.format("<body><joint/>" + BOX.format("") + "</body>"),
            MOTOR,
            {"robot-world"},  # parent and child do not collide
        ),
        (
            ARM.format("<body><joint/>" + BOX.format("") + "</body>"),
            MOTOR + "<option><flag filterparent='disable'/></option>",
            {"robot-robot", "robot-world"},
        ),
        (
            ARM.format("<body>" + BOX.format("") + "</body>"),
            MOTOR,
            {"robot-world"},  # welded together
        ),
        (box("one", 0, 1), "<option><flag contact='disable'/></option>", set()),
        (
            "<body name='one'><freejoint/><geom name='a' size='.1' contype='0' conaffinity='0'/>"
            "</body>",
            "<contact><pair geom1='a' geom2='floor'/></contact>",
            {"object-world"},
        ),
    ],
)
def test_groups_are_those_that_the_scene_lets_touch(
    bodies: str, rest: str, expected: set[str]
) -> None:
    assert set(groups(scene(bodies, rest))) == expected


def test_flexible_objects_are_a_group_of_their_own() -> None:
    cloth = (
        "<flexcomp name='cloth' type='grid' count='3 3 1' spacing='.1 .1 .1' dim='2' pos='0 0 1' "
        "radius='.01' mass='1'><contact selfcollide='none'/></flexcomp>"
    )
    found = scene(cloth + box("one", 5, 1))
    assert set(groups(found)) == {"object-deformable", "object-world", "deformable-world"}
    model, fallen = found.model, found.model.qpos0[None, None].copy()
    slides = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE]
    fallen[..., slides[2::3]] = -0.995  # every vertex, a ball of 1 cm, 5 mm over the floor
    depth = penetration(found, fallen)
    assert depth.depth["deformable-world"][0, 0] == pytest.approx(0.005, abs=1e-6)
    deepest = depth.deepest["deformable-world"]
    assert deepest is not None and set(deepest.between) == {"floor", "cloth"}


def test_names_of_groups_have_one_order() -> None:
    assert group_of("world", "robot") == group_of("robot", "world") == "robot-world"
