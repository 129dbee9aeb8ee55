"""USD: joints, their frames, limits and drives, and the trees that they make."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from orbisim.errors import SceneError
from orbisim.scene import Scene
from tests.scene.usd.usd_text import body, joins, joint, load

DEGREE = math.pi / 180
HINGE, SLIDE, BALL, FREE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("HINGE", "SLIDE", "BALL", "FREE")
)
Q0 = (0.5, 0.5, -0.5, 0.5)
Q1 = (0.8, 0.0, 0.6, 0.0)


def turn(quat: tuple) -> Rotation:
    return Rotation.from_quat(np.roll(quat, -1))


def poses(model: mujoco.MjModel, **coordinates: float) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name, value in coordinates.items():
        data.joint(name).qpos[:] = value
    mujoco.mj_kinematics(model, data)
    return data


def check_frames(
    data: mujoco.MjData, moved: Rotation, offset: tuple, frames: tuple, names: tuple
) -> None:
    """body1 = body0 frame0 (offset, moved) frame1^-1, with numbers that need no OrbiSim."""
    (pos0, rot0), (pos1, rot1) = frames
    first, second = (data.body(name) for name in names)
    r0 = Rotation.from_matrix(first.xmat.reshape(3, 3))
    expected_rotation = r0 * turn(rot0) * moved * turn(rot1).inv()
    anchor = first.xpos + r0.apply(np.array(pos0) + turn(rot0).apply(offset))
    expected_position = anchor - expected_rotation.apply(pos1)
    np.testing.assert_allclose(second.xpos, expected_position, atol=1e-9)
    np.testing.assert_allclose(second.xmat.reshape(3, 3), expected_rotation.as_matrix(), atol=1e-9)


FRAMES = (((0.1, 0.2, 0.3), Q0), ((-0.3, 0.1, 0.0), Q1))


def pair(
    tmp_path: Path, kind: str, content: str = "", *, swapped: bool = False, extra: tuple = ()
) -> Scene:
    """Two bodies A and B joined by J; A is fixed to the world where it stands."""
    ends = ("/B", "/A") if swapped else ("/A", "/B")
    (pos0, rot0), (pos1, rot1) = FRAMES
    text = (
        body("A", pos=(1, 2, 3), quat=(0.8, 0.6, 0, 0))
        + body("B", pos=(5, 5, 5))
        + joint("PhysicsFixedJoint", "Base", joins(None, "/A", (1, 2, 3), rot0=(0.8, 0.6, 0, 0)))
        + joint(kind, "J", joins(*ends, pos0, pos1, rot0, rot1) + "\n" + content, extra=extra)
    )  # fmt: skip
    return load(tmp_path, text)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("axis", "XYZ")
def test_revolute_frames(tmp_path: Path, axis: str, swapped: bool) -> None:
    """The authored pose of B fits nowhere: the joint frames decide, whichever body is body0."""
    scene = pair(
        tmp_path, "PhysicsRevoluteJoint", f'uniform token physics:axis = "{axis}"', swapped=swapped
    )
    assert list(scene.model.jnt_type) == [HINGE]
    assert any("miss the joint" in text for text in scene.warnings)
    names = ("B", "A") if swapped else ("A", "B")
    for angle in (-1.1, 0.0, 0.7):
        data = poses(scene.model, J=angle)
        moved = Rotation.from_rotvec(angle * np.eye(3)["XYZ".index(axis)])
        check_frames(data, moved, (0, 0, 0), FRAMES, names)
    np.testing.assert_allclose(data.body("A").xpos, [1, 2, 3], atol=1e-12)


@pytest.mark.parametrize("swapped", [False, True])
def test_prismatic_frames(tmp_path: Path, swapped: bool) -> None:
    content = 'uniform token physics:axis = "Y"\nfloat physics:lowerLimit = -0.5'
    scene = pair(tmp_path, "PhysicsPrismaticJoint", content, swapped=swapped)
    assert list(scene.model.jnt_type) == [SLIDE]
    assert scene.model.jnt_range[0, 0] == -0.5 and scene.model.jnt_range[0, 1] >= 1e9
    names = ("B", "A") if swapped else ("A", "B")
    for distance in (-0.3, 0.4):
        data = poses(scene.model, J=distance)
        check_frames(data, Rotation.identity(), (0, distance, 0), FRAMES, names)


@pytest.mark.parametrize("swapped", [False, True])
def test_spherical_frames(tmp_path: Path, swapped: bool) -> None:
    scene = pair(tmp_path, "PhysicsSphericalJoint", swapped=swapped)
    assert list(scene.model.jnt_type) == [BALL]
    data = mujoco.MjData(scene.model)
    data.qpos[:] = np.array([0.5, 0.1, -0.7, 0.5]) / math.sqrt(1.0)
    mujoco.mj_kinematics(scene.model, data)
    anchors = []
    for (pos, _), name in zip(FRAMES, ("B", "A") if swapped else ("A", "B"), strict=True):
        item = data.body(name)
        anchors.append(item.xpos + item.xmat.reshape(3, 3) @ pos)
    np.testing.assert_allclose(anchors[0], anchors[1], atol=1e-9)


def locks(*free: str, **limits: tuple[float, float]) -> tuple[str, tuple[str, ...]]:
    """Limits of a generic joint: everything but the free and limited axes is locked."""
    lines, applied = [], []
    for token in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ"):
        if token in free:
            continue
        low, high = limits.get(token, (1, -1))
        applied.append(f"PhysicsLimitAPI:{token}")
        lines += [f"float limit:{token}:physics:low = {low}",
                  f"float limit:{token}:physics:high = {high}"]  # fmt: skip
    return "\n".join(lines), tuple(applied)


D6 = {
    (): [],
    ("rotZ",): [HINGE],
    ("transX",): [SLIDE],
    ("transX", "transZ"): [SLIDE, SLIDE],
    ("rotX", "rotY"): [HINGE, HINGE],
    ("rotX", "rotY", "rotZ"): [BALL],
    ("transX", "rotX"): [SLIDE, HINGE],
    ("transX", "transY", "transZ", "rotX", "rotY", "rotZ"): [FREE],
}


@pytest.mark.parametrize("free", D6, ids=lambda free: "-".join(free) or "locked")
def test_generic_joints(tmp_path: Path, free: tuple[str, ...]) -> None:
    content, applied = locks(*free)
    model = pair(tmp_path, "PhysicsJoint", content, extra=applied).model
    assert list(model.jnt_type) == D6[free]


@pytest.mark.parametrize("swapped", [False, True])
def test_generic_joint_frames(tmp_path: Path, swapped: bool) -> None:
    """Translation along frame0's axes, then rotation about x, y and z as they turn."""
    content, applied = locks("transX", "transZ", rotX=(-90, 90), rotY=(-80, 80), rotZ=(-70, 70))
    scene = pair(tmp_path, "PhysicsJoint", content, extra=applied, swapped=swapped)
    assert sorted(scene.model.jnt_type) == sorted([SLIDE, SLIDE, HINGE, HINGE, HINGE])
    values = {"J_transX": 0.3, "J_transZ": -0.2, "J_rotX": 0.4, "J_rotY": -0.5, "J_rotZ": 0.6}
    data = poses(scene.model, **values)
    moved = Rotation.from_euler("XYZ", [0.4, -0.5, 0.6])
    names = ("B", "A") if swapped else ("A", "B")
    check_frames(data, moved, (0.3, 0, -0.2), FRAMES, names)
    np.testing.assert_allclose(scene.model.joint("J_rotZ").range, [-70 * DEGREE, 70 * DEGREE])


@pytest.mark.parametrize("swapped", [False, True])
def test_an_authored_pose_away_from_zero_is_the_reference(tmp_path: Path, swapped: bool) -> None:
    """Coordinates stay UsdPhysics'; MuJoCo's reference pose is the authored one."""
    quat = (math.cos(0.35), 0, 0, math.sin(0.35))  # 0.7 rad about z
    where = {"pos": (1, 0, 0), "quat": quat}
    text = (
        body("A") + body("B", **where)
        + joint("PhysicsFixedJoint", "Base", joins(None, "/A"))
        + joint("PhysicsRevoluteJoint", "J",
                joins(*(("/B", "/A") if swapped else ("/A", "/B")),
                      *(((0, 0, 0), (1, 0, 0)) if swapped else ((1, 0, 0), (0, 0, 0))))
                + '\nuniform token physics:axis = "Z"\nfloat physics:upperLimit = 50')
    )  # fmt: skip
    model = load(tmp_path, text).model
    expected = -0.7 if swapped else 0.7
    assert model.qpos0[0] == pytest.approx(expected, abs=1e-9)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("B").xpos, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(data.body("B").xquat, quat, atol=1e-12)
    data = poses(model, J=0.0)
    np.testing.assert_allclose(data.body("B").xquat, [1, 0, 0, 0], atol=1e-9)
    assert model.jnt_range[0, 1] == pytest.approx(50 * DEGREE)


def test_joint_positions_scale_with_the_prim_they_are_in(tmp_path: Path) -> None:
    text = (
        body("A", scale=(2, 1, 1))
        + body("B", pos=(4, 0, 0), scale=(3, 3, 3))
        + joint("PhysicsFixedJoint", "Base", joins(None, "/A"))
        + joint("PhysicsRevoluteJoint", "J", joins("/A", "/B", (0.5, 0, 0), (-1, 0, 0)))
    )
    model = load(tmp_path, text).model
    np.testing.assert_allclose(model.joint("J").pos, [-3, 0, 0])
    np.testing.assert_allclose(model.body("B").pos, [4, 0, 0])


def test_joint_to_a_prim_that_is_no_body(tmp_path: Path) -> None:
    text = """
    def Xform "Wall"
    {
        double3 xformOp:translate = (0, 0, 2)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    """
    text += body("B", pos=(0, 0, 2)) + joint("PhysicsRevoluteJoint", "J", joins("/Wall", "/B"))
    model = load(tmp_path, text).model
    assert list(model.jnt_type) == [HINGE] and model.nbody == 2
    np.testing.assert_allclose(model.body("B").pos, [0, 0, 2])


def test_cone_limits(tmp_path: Path) -> None:
    content = "float physics:coneAngle0Limit = 30\nfloat physics:coneAngle1Limit = 40"
    scene = pair(tmp_path, "PhysicsSphericalJoint", content)
    np.testing.assert_allclose(scene.model.jnt_range[0], [0, 40 * DEGREE])
    assert any("coneAngle" in str(entry) for entry in scene.unsupported)


def test_a_distance_joint_is_a_tendon(tmp_path: Path) -> None:
    """A pendulum on a string: it falls freely, then swings at no more than the distance."""
    text = body("B", pos=(0.5, 0, 0)) + joint(
        "PhysicsDistanceJoint", "Rope", joins(None, "/B") + "\nfloat physics:maxDistance = 1"
    )
    model = load(tmp_path, text).model
    np.testing.assert_allclose(model.tendon_range[0], [0, 1])
    data = mujoco.MjData(model)
    farthest = 0.0
    for _ in range(1500):
        mujoco.mj_step(model, data)
        farthest = max(farthest, float(np.linalg.norm(data.body("B").xpos)))
    assert 0.98 < farthest < 1.05


FREE_FALL = -9.81


def test_prismatic_drive_at_rest(tmp_path: Path) -> None:
    """k (target - q) = m g: 200 N/m, 1 kg, target 0.5 m."""
    content = """
    uniform token physics:axis = "Z"
    float drive:linear:physics:stiffness = 200
    float drive:linear:physics:damping = 30
    float drive:linear:physics:targetPosition = 0.5
    """
    text = body("B") + joint("PhysicsPrismaticJoint", "J", joins(None, "/B") + content,
                             extra=("PhysicsDriveAPI:linear",))  # fmt: skip
    model = load(tmp_path, text).model
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(2000):
        mujoco.mj_step(model, data)
    assert data.qpos[0] == pytest.approx(0.5 - 9.81 / 200, abs=1e-6)
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def test_angular_drive_force(tmp_path: Path) -> None:
    """Gains per degree: torque of 2 N m/deg at 10 degrees off, and 0.5 N m s/deg of damping."""
    content = """
    float drive:angular:physics:stiffness = 2
    float drive:angular:physics:damping = 0.5
    float drive:angular:physics:targetVelocity = 20
    float drive:angular:physics:maxForce = 25
    """
    text = body("B") + joint("PhysicsRevoluteJoint", "J", joins(None, "/B") + content,
                             extra=("PhysicsDriveAPI:angular",))  # fmt: skip
    model = load(tmp_path, text).model
    data = mujoco.MjData(model)
    for target, position, velocity, force in (
        (0, 10, 0, -20 + 10),  # the authored target velocity pushes on: 0.5 * 20
        (0, 0, 30, -15 + 10),
        (5, 0, 0, 10 + 10),
        (0, 40, 0, -25),  # bounded
    ):
        data.ctrl[0] = target * DEGREE
        data.qpos[0], data.qvel[0] = position * DEGREE, velocity * DEGREE
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(force, rel=1e-6)


def test_drives_without_stiffness_and_without_gains(tmp_path: Path) -> None:
    servo = (
        "float drive:angular:physics:damping = 3\nfloat drive:angular:physics:targetVelocity = 90"
    )
    motor = "float drive:angular:physics:maxForce = 7"
    text = body("A") + body("B")
    for name, content in (("A", servo), ("B", motor)):
        text += joint("PhysicsRevoluteJoint", f"J{name}", joins(None, f"/{name}") + "\n" + content,
                      extra=("PhysicsDriveAPI:angular",))  # fmt: skip
    model = load(tmp_path, text).model
    np.testing.assert_allclose(model.key("initial").ctrl, [math.pi / 2, 0])
    data = mujoco.MjData(model)
    data.ctrl[:] = [1.0, 5.0]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, [3 / DEGREE, 5.0], rtol=1e-6)
    data.ctrl[:] = [1.0, 9.0]
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[1] == pytest.approx(7.0)


def test_an_acceleration_drive_does_not_feel_the_inertia(tmp_path: Path) -> None:
    content = """
    uniform token drive:linear:physics:type = "acceleration"
    float drive:linear:physics:stiffness = 100
    """
    mass = "float physics:mass = 8\nfloat3 physics:diagonalInertia = (1, 1, 1)"
    text = body("B", mass=mass) + joint(
        "PhysicsPrismaticJoint", "J", joins(None, "/B") + content, extra=("PhysicsDriveAPI:linear",)
    )
    scene = load(tmp_path, text)
    data = mujoco.MjData(scene.model)
    data.ctrl[0] = 0.2
    mujoco.mj_forward(scene.model, data)
    assert data.qacc[0] == pytest.approx(20)
    assert any("acceleration" in str(entry) for entry in scene.unsupported)


@pytest.mark.parametrize("name", ["stiffness", "damping", "maxForce"])
def test_negative_gains_are_refused(tmp_path: Path, name: str) -> None:
    content = (
        f"\nfloat drive:angular:physics:stiffness = 1\nfloat drive:angular:physics:{name} = -1"
    )
    content = content.replace("stiffness = 1\nfloat drive:angular:physics:stiffness", "stiffness")
    text = body("B") + joint("PhysicsRevoluteJoint", "J", joins(None, "/B") + content,
                             extra=("PhysicsDriveAPI:angular",))  # fmt: skip
    with pytest.raises(SceneError, match=f"{name} is -"):
        load(tmp_path, text)


def test_floating_articulations_are_rooted_where_they_say(tmp_path: Path) -> None:
    """The root is neither first in the stage nor body0 of every joint."""
    text = (
        body("Leg", pos=(0, 0, 1)) + body("Arm", pos=(0, 0, 3))
        + body("Trunk", pos=(0, 0, 2), extra=("PhysicsArticulationRootAPI",))
        + joint("PhysicsRevoluteJoint", "Hip", joins("/Leg", "/Trunk", (0, 0, 1)))
        + joint("PhysicsRevoluteJoint", "Shoulder", joins("/Trunk", "/Arm", (0, 0, 1)))
    )  # fmt: skip
    model = load(tmp_path, text).model
    assert model.body("Trunk").parentid[0] == 0
    assert model.body("Leg").parentid[0] == model.body("Trunk").id
    assert sorted(model.jnt_type) == [FREE, HINGE, HINGE]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name, height in (("Leg", 1), ("Trunk", 2), ("Arm", 3)):
        np.testing.assert_allclose(data.body(name).xpos, [0, 0, height], atol=1e-12)


def test_nested_bodies_are_bodies_of_their_own(tmp_path: Path) -> None:
    inner = body("Inner", pos=(0, 0, 1))
    text = body("Outer", inner, pos=(1, 0, 0))
    free = load(tmp_path, text).model
    assert list(free.jnt_type) == [FREE, FREE]
    np.testing.assert_allclose(free.body("Inner").pos, [1, 0, 1])
    held = load(tmp_path, text + joint("PhysicsFixedJoint", "J",
                joins("/Outer", "/Outer/Inner", (0, 0, 1)))).model  # fmt: skip
    assert list(held.jnt_type) == [FREE]
    assert held.body("Inner").parentid[0] == held.body("Outer").id


def test_kinematic_bodies(tmp_path: Path) -> None:
    """They are moved from outside, carry what is fixed to them, and ignore other joints."""
    kinematic = "bool physics:kinematicEnabled = 1\n"
    mass = "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 1, 1)"
    text = (
        body("Cart", mass=mass + "\n" + kinematic)
        + body("Load", pos=(0, 0, 1), mass=mass + "\n" + kinematic)
        + body("Pendulum", pos=(1, 0, 0))
        + joint("PhysicsFixedJoint", "Bolt", joins("/Cart", "/Load", (0, 0, 1)))
        + joint("PhysicsRevoluteJoint", "Swing", joins("/Cart", "/Pendulum", (1, 0, 0)))
        + joint("PhysicsPrismaticJoint", "Rail", joins(None, "/Cart"))
    )
    scene = load(tmp_path, text)
    model = scene.model
    assert model.nmocap == 1 and model.body("Cart").mocapid[0] == 0
    assert model.body("Load").parentid[0] == model.body("Cart").id
    assert model.body("Pendulum").parentid[0] == model.body("Cart").id
    assert [model.joint(i).name for i in range(model.njnt)] == ["Swing"]
    assert any("between kinematic bodies" in str(entry) for entry in scene.unsupported)


def test_kinematic_body_at_the_end_of_a_chain_stays_a_root(tmp_path: Path) -> None:
    kinematic = "float physics:mass = 1\nbool physics:kinematicEnabled = 1"
    text = (
        body("Arm", pos=(0, 0, 0))
        + body("Hand", pos=(1, 0, 0), mass=kinematic)
        + joint("PhysicsRevoluteJoint", "Shoulder", joins(None, "/Arm"))
        + joint("PhysicsSphericalJoint", "Wrist", joins("/Arm", "/Hand", (1, 0, 0)))
    )
    model = load(tmp_path, text).model
    assert model.body("Hand").mocapid[0] == 0 and model.body("Hand").parentid[0] == 0
    assert model.neq == 1 and model.eq_type[0] == mujoco.mjtEq.mjEQ_CONNECT


ABOUT_Y = '\nuniform token physics:axis = "Y"\n'


def four_bar(closing: str, extra: str = "") -> str:
    """Three bars on hinges about y, closed to the ground by the given joint."""
    ends = {
        "A": joins(None, "/Left", (0, 0, 0), (0, 0, -0.5)),
        "B": joins("/Left", "/Top", (0, 0, 0.5), (-0.5, 0, 0)),
        "C": joins("/Top", "/Right", (0.5, 0, 0), (0, 0, 0.5)),
        "D": joins(None, "/Right", (1, 0, 0), (0, 0, -0.5)),
    }
    extra = "bool physics:excludeFromArticulation = 1\n" + extra
    return (
        body("Left", pos=(0, 0, 0.5))
        + body("Top", pos=(0.5, 0, 1))
        + body("Right", pos=(1, 0, 0.5))
        + "".join(joint("PhysicsRevoluteJoint", name, ends[name] + ABOUT_Y) for name in "ABC")
        + joint(closing, "D", ends["D"] + ABOUT_Y + extra)
    )


@pytest.mark.parametrize("closing", ["PhysicsRevoluteJoint", "PhysicsSphericalJoint"])
def test_loops_stay_closed(tmp_path: Path, closing: str) -> None:
    model = load(tmp_path, four_bar(closing)).model
    assert list(model.jnt_type) == [HINGE] * 3
    assert model.neq == (2 if closing == "PhysicsRevoluteJoint" else 1)
    data = mujoco.MjData(model)
    data.qvel[0] = 0.1
    for _ in range(300):
        mujoco.mj_step(model, data)
    right = data.body("Right")
    foot = right.xpos + right.xmat.reshape(3, 3) @ [0, 0, -0.5]
    np.testing.assert_allclose(foot, [1, 0, 0], atol=2e-3)
    assert data.qpos[0] > 0.05  # it moves
    assert data.qpos[0] == pytest.approx(-data.qpos[1], abs=5e-3)  # a parallelogram


def test_a_fixed_joint_that_closes_a_loop_is_a_weld(tmp_path: Path) -> None:
    model = load(tmp_path, four_bar("PhysicsFixedJoint")).model
    assert model.neq == 1 and model.eq_type[0] == mujoco.mjtEq.mjEQ_WELD
    data = mujoco.MjData(model)
    for _ in range(200):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.body("Right").xpos, [1, 0, 0.5], atol=5e-3)


def test_the_joint_that_no_constraint_expresses_is_kept_in_the_tree(tmp_path: Path) -> None:
    """Without the wish to exclude it, the slider of a crank stays a slider."""
    text = four_bar("PhysicsPrismaticJoint").replace(
        "bool physics:excludeFromArticulation = 1\n", ""
    )
    model = load(tmp_path, text).model
    kinds = {model.joint(i).name: model.jnt_type[i] for i in range(model.njnt)}
    assert kinds["D"] == SLIDE and len(kinds) == 3


def test_loops_that_cannot_be_expressed_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="closes a loop as a PhysicsPrismaticJoint") as caught:
        load(tmp_path, four_bar("PhysicsPrismaticJoint"))
    assert "/D" in str(caught.value)


def test_limits_of_loop_joints_are_listed(tmp_path: Path) -> None:
    scene = load(tmp_path, four_bar("PhysicsRevoluteJoint", "float physics:upperLimit = 10"))
    assert any(
        "limits and drives of a joint that closes a loop" in str(e) for e in scene.unsupported
    )


def test_joints_that_join_nothing(tmp_path: Path) -> None:
    text = body("A") + joint("PhysicsFixedJoint", "Nothing", joins(None, None))
    text += joint("PhysicsFixedJoint", "Self", joins("/A", "/A"))
    text += joint("PhysicsFixedJoint", "Off", joins(None, "/A") + "\nbool physics:jointEnabled = 0")
    text += joint(
        "PhysicsRevoluteJoint", "Weak", joins(None, "/A") + "\nfloat physics:breakForce = 9"
    )
    scene = load(tmp_path, text)
    listed = " ".join(str(entry) for entry in scene.unsupported)
    for name in ("/Nothing", "/Self", "/Off", "physics:breakForce 9"):
        assert name in listed
    assert list(scene.model.jnt_type) == [HINGE]


def test_a_joint_to_a_prim_that_does_not_exist(tmp_path: Path) -> None:
    text = body("A") + joint("PhysicsFixedJoint", "J", joins("/A", "/Gone"))
    with pytest.raises(SceneError, match="/J: physics:body1 leads to </Gone>"):
        load(tmp_path, text)


def test_joint_states_and_velocities_of_a_chain(tmp_path: Path) -> None:
    """Authored velocities of the bodies become joint velocities."""
    spin = "vector3f physics:angularVelocity = (0, 0, 90)\n"
    mass = "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 1, 1)\n"
    text = (
        body("A") + body("B", pos=(1, 0, 0), mass=mass + spin)
        + joint("PhysicsFixedJoint", "Base", joins(None, "/A"))
        + joint("PhysicsRevoluteJoint", "J",
                joins("/A", "/B", (1, 0, 0)) + '\nuniform token physics:axis = "Z"')
        + body("C")
        + joint("PhysicsRevoluteJoint", "K", joins(None, "/C") + """
                float state:angular:physics:position = 30
                float state:angular:physics:velocity = 60""",
                extra=("PhysicsJointStateAPI:angular",))
    )  # fmt: skip
    model = load(tmp_path, text).model
    key = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, key, 0)
    assert key.joint("J").qvel[0] == pytest.approx(math.pi / 2)
    assert key.joint("K").qpos[0] == pytest.approx(math.pi / 6)
    assert key.joint("K").qvel[0] == pytest.approx(math.pi / 3)


def test_coupled_joints(tmp_path: Path) -> None:
    text = body("A") + body("B") + body("C")
    text += joint("PhysicsRevoluteJoint", "Leader", joins(None, "/A"))
    text += joint("PhysicsRevoluteJoint", "Follower", joins(None, "/B") + """
        rel newton:mimicJoint = </Leader>
        float newton:mimicCoef0 = 90
        float newton:mimicCoef1 = -2""", extra=("NewtonMimicAPI",))  # fmt: skip
    text += joint("PhysicsRevoluteJoint", "Finger", joins(None, "/C") + """
        rel physxMimicJoint:rotX:referenceJoint = </Leader>
        float physxMimicJoint:rotX:gearing = 3
        float physxMimicJoint:rotX:offset = 45""", extra=("PhysxMimicJointAPI:rotX",))  # fmt: skip
    model = load(tmp_path, text).model
    assert model.neq == 2
    np.testing.assert_allclose(model.eq_data[0, :5], [math.pi / 2, -2, 0, 0, 0])
    np.testing.assert_allclose(model.eq_data[1, :5], [-math.pi / 4, -3, 0, 0, 0])


def test_newton_actuators_and_passive_joints(tmp_path: Path) -> None:
    text = body("A") + joint("PhysicsRevoluteJoint", "J", joins(None, "/A") + """
        float newton:armature = 0.5
        float newton:damping = 0.1
        float newton:friction = 0.2""", extra=("NewtonJointAPI",))  # fmt: skip
    text += """
    def NewtonActuator "PD" (
        prepend apiSchemas = ["NewtonPDControlAPI", "NewtonMaxEffortClampingAPI",
                              "NewtonActuatorDelayAPI"]
    )
    {
        rel newton:targets = </J>
        float newton:kp = 100
        float newton:kd = 10
        float newton:maxEffort = 50
        int newton:delaySteps = 3
    }
    def NewtonActuator "Net" (
        prepend apiSchemas = ["NewtonNeuralControlAPI"]
    )
    {
        rel newton:targets = </J>
    }
    """
    scene = load(tmp_path, text)
    model = scene.model
    dof = model.joint("J").dofadr[0]
    assert model.dof_armature[dof] == 0.5
    assert model.dof_damping[dof] == pytest.approx(0.1 / DEGREE)
    assert model.dof_frictionloss[dof] == pytest.approx(0.2)
    actuator = model.actuator("PD")
    assert actuator.gainprm[0] == 100 and actuator.biasprm[2] == -10
    np.testing.assert_allclose(actuator.forcerange, [-50, 50])
    assert model.nu == 1
    assert any("NewtonNeuralControlAPI" in str(entry) for entry in scene.unsupported)
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.1
    forces = []
    for _ in range(6):
        mujoco.mj_step(model, data)
        forces.append(abs(data.actuator_force[0]))
    assert max(forces[:3]) < 1e-9 < forces[4]  # it answers three steps late
