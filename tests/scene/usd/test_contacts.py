"""USD: what collides with what, and how contacts slide and bounce."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene import Scene
from orbisim.scene.usd.surfaces import damping_ratio
from tests.scene.usd.usd_text import body, joins, joint, load, schemas


def ball(name: str, content: str = "", *, extra: tuple[str, ...] = (), geom: str = "") -> str:
    """A free ball of 0.5 m radius at the origin: all balls overlap."""
    applied = schemas("PhysicsCollisionAPI", "MaterialBindingAPI")
    shape = f'def Sphere "{name}Shape" ({applied})\n{{\ndouble radius = 0.5\n{geom}\n}}\n'
    return body(name, content + shape, extra=extra)


def touching(scene: Scene) -> set[frozenset[str]]:
    """Pairs of bodies in contact in the initial pose."""
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    names = [scene.model.body(i).name for i in range(scene.model.nbody)]
    return {
        frozenset(names[scene.model.geom_bodyid[g]] for g in contact.geom)
        for contact in data.contact
    }


def pairs(*names: str) -> set[frozenset[str]]:
    return {frozenset(pair.split()) for pair in names}


def test_filtered_pairs_of_bodies(tmp_path: Path) -> None:
    text = ball("A", "rel physics:filteredPairs = [</B>]\n", extra=("PhysicsFilteredPairsAPI",))
    scene = load(tmp_path, text + ball("B") + ball("C"))
    assert touching(scene) == pairs("A C", "B C")


def test_filtered_pairs_of_one_collider_of_several(tmp_path: Path) -> None:
    two = """
    def Sphere "Low" (prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsFilteredPairsAPI"])
    {
        double radius = 0.5
        rel physics:filteredPairs = [</B>]
    }
    def Sphere "High" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
        double radius = 0.1
        double3 xformOp:translate = (0, 0, 5)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    """
    scene = load(tmp_path, body("A", two) + ball("B") + ball("C"))
    assert touching(scene) == pairs("A C", "B C")
    model = scene.model
    low, high, other = (model.geom(name) for name in ("Low", "High", "BShape"))

    def collide(one, two) -> bool:
        return bool(one.contype[0] & two.conaffinity[0] or two.contype[0] & one.conaffinity[0])

    assert not collide(low, other) and collide(high, other) and collide(low, high)


GROUPS = """
def PhysicsCollisionGroup "One" (prepend apiSchemas = ["CollectionAPI:colliders"])
{
    rel collection:colliders:includes = [</A>]
    rel physics:filteredGroups = [</Two>, </One>]
}
def PhysicsCollisionGroup "Two" (prepend apiSchemas = ["CollectionAPI:colliders"])
{
    rel collection:colliders:includes = [</B>, </C>]
}
"""


def test_collision_groups(tmp_path: Path) -> None:
    scene = load(tmp_path, "".join(ball(name) for name in "ABCD") + GROUPS)
    assert touching(scene) == pairs("A D", "B C", "B D", "C D")


def test_inverted_collision_groups(tmp_path: Path) -> None:
    inverted = GROUPS.replace(
        "rel physics:filteredGroups = [</Two>, </One>]",
        "bool physics:invertFilteredGroups = 1\nrel physics:filteredGroups = [</Two>]",
    )
    scene = load(tmp_path, "".join(ball(name) for name in "ABCD") + inverted)
    assert touching(scene) == pairs("A B", "A C", "B C", "B D", "C D")


def test_merged_collision_groups(tmp_path: Path) -> None:
    merged = GROUPS.replace(
        "{\n    rel coll", '{\n    string physics:mergeGroup = "all"\n    rel coll'
    )
    scene = load(tmp_path, "".join(ball(name) for name in "ABCD") + merged)
    assert touching(scene) == pairs("A D", "B D", "C D")


def test_disabled_collisions(tmp_path: Path) -> None:
    scene = load(tmp_path, ball("A", geom="bool physics:collisionEnabled = 0") + ball("B"))
    assert touching(scene) == set()
    assert scene.model.body("A").mass[0] == 1


@pytest.mark.parametrize("enabled", [False, True])
def test_bodies_that_a_joint_joins(tmp_path: Path, enabled: bool) -> None:
    """By default they do not collide; C collides with both."""
    flag = f"\nbool physics:collisionEnabled = {int(enabled)}"
    text = ball("A") + ball("B") + ball("C")
    text += joint("PhysicsRevoluteJoint", "J", joins("/A", "/B") + flag)
    found = touching(load(tmp_path, text))
    assert found == pairs("A C", "B C") | (pairs("A B") if enabled else set())


def test_one_joint_that_lets_its_bodies_collide_leaves_the_others_alone(tmp_path: Path) -> None:
    text = ball("A") + ball("B") + ball("C")
    text += joint(
        "PhysicsRevoluteJoint", "J", joins("/A", "/B") + "\nbool physics:collisionEnabled = 1"
    )
    text += joint("PhysicsRevoluteJoint", "K", joins("/B", "/C"))
    assert touching(load(tmp_path, text)) == pairs("A B", "A C")


def test_bodies_joined_to_one_that_is_fixed_to_the_world(tmp_path: Path) -> None:
    """MuJoCo would let them collide; UsdPhysics does not."""
    text = ball("Base") + ball("Arm")
    text += joint("PhysicsFixedJoint", "F", joins(None, "/Base"))
    text += joint("PhysicsRevoluteJoint", "J", joins("/Base", "/Arm"))
    assert touching(load(tmp_path, text)) == set()


@pytest.mark.parametrize(
    "attribute", ["newton:selfCollisionEnabled", "physxArticulation:enabledSelfCollisions"]
)
def test_articulations_without_self_collision(tmp_path: Path, attribute: str) -> None:
    inner = ball("A") + ball("B") + ball("C")
    inner += joint("PhysicsRevoluteJoint", "J", joins("/Robot/A", "/Robot/B"))
    inner += joint("PhysicsRevoluteJoint", "K", joins("/Robot/B", "/Robot/C"))
    robot = f'def Xform "Robot" ({schemas("PhysicsArticulationRootAPI")})\n{{\n'
    robot += f"bool {attribute} = 0\n{inner}}}\n"
    assert touching(load(tmp_path, robot + ball("D"))) == pairs("A D", "B D", "C D")


def test_a_filter_that_leads_nowhere(tmp_path: Path) -> None:
    text = ball("A", "rel physics:filteredPairs = [</Gone>]\n", extra=("PhysicsFilteredPairsAPI",))
    with pytest.raises(SceneError, match="filteredPairs leads to </Gone>"):
        load(tmp_path, text)


def material(content: str) -> str:
    return f'def Material "M" ({schemas("PhysicsMaterialAPI")})\n{{\n{content}\n}}\n'


FLOOR = """
def Plane "Floor" (prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"])
{
    rel material:binding:physics = </M>
}
"""


def box(pos: tuple[float, float, float]) -> str:
    applied = schemas("PhysicsCollisionAPI", "MaterialBindingAPI")
    shape = f'def Cube "Cube" ({applied})\n{{\ndouble size = 0.2\nrel material:binding = </M>\n}}\n'
    velocity = "\nvector3f physics:velocity = (2, 0, 0)"
    return body("Box", shape, pos=pos, mass="float physics:mass = 1" + velocity)


def test_dynamic_friction_stops_a_sliding_box(tmp_path: Path) -> None:
    """v^2 / (2 mu g) = 0.68 m for 2 m/s and mu = 0.3."""
    surface = material("float physics:dynamicFriction = 0.3\nfloat physics:staticFriction = 0.6")
    scene = load(tmp_path, surface + FLOOR + box((0, 0, 0.1)))
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    assert data.body("Box").xpos[0] == pytest.approx(4 / (2 * 0.3 * 9.81), rel=0.03)
    assert any("staticFriction 0.6 differs" in str(entry) for entry in scene.unsupported)


@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.9])
def test_restitution(tmp_path: Path, restitution: float) -> None:
    """A ball dropped from 1 m leaves the floor with this share of its speed."""
    surface = material(
        f"float physics:dynamicFriction = 1\nfloat physics:restitution = {restitution}"
    )
    drop = ball("Ball", geom="rel material:binding:physics = </M>").replace(
        "double3 xformOp:translate = (0.0, 0.0, 0.0)", "double3 xformOp:translate = (0, 0, 1.5)"
    )
    model = load(tmp_path, surface + FLOOR + drop).model
    data = mujoco.MjData(model)
    speeds = []
    for _ in range(600):
        mujoco.mj_step(model, data)
        speeds.append(data.qvel[2])
    down, up = min(speeds), max(speeds)
    assert up / -down == pytest.approx(restitution, abs=0.06)


def test_damping_ratio_of_the_limits() -> None:
    assert damping_ratio(1.0) == pytest.approx(0.0, abs=1e-9)
    assert damping_ratio(math.exp(-2)) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("float physics:restitution = 1.5", "physics:restitution is 1.5; expected 0 to 1"),
        ("float physics:dynamicFriction = -1", "friction is -1"),
        ("float physics:density = -1", "physics:density is -1"),
    ],
)
def test_materials_that_make_no_sense(tmp_path: Path, content: str, problem: str) -> None:
    with pytest.raises(SceneError, match=problem):
        load(tmp_path, material(content) + FLOOR + box((0, 0, 1)))


def test_margins(tmp_path: Path) -> None:
    """Both schemas inflate a collider: it rests that much above the floor."""
    newton = "float newton:contactMargin = 2\nfloat newton:contactGap = 1"
    physx = "float physxCollision:restOffset = 3\nfloat physxCollision:contactOffset = 5"
    text = ball("A", geom=newton) + ball("B", geom=physx)
    model = load(tmp_path, text, meters=0.01).model
    np.testing.assert_allclose(model.geom_margin, [0.02, 0.03])
    np.testing.assert_allclose(model.geom_gap, [0.01, 0.02])


def test_gravity_can_be_off_for_one_body(tmp_path: Path) -> None:
    mass = "float physics:mass = 1\nbool physxRigidBody:disableGravity = 1"
    model = load(tmp_path, body("A", mass=mass) + body("B")).model
    data = mujoco.MjData(model)
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert data.body("A").xpos[2] == pytest.approx(0, abs=1e-12) and data.body("B").xpos[2] < -0.1
