"""URDF: links, joints, mimics, options, and what cannot be carried."""

from __future__ import annotations

import builtins
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim import load_scene
from orbisim.errors import InputError, MissingDependencyError, SceneError, UnknownNameError
from orbisim.scene import Scene
from orbisim.scene.urdf import read_urdf_string
from tests.scene.urdf.urdf_text import collision, inertial, joint, link, robot, two_links, visual

LIMIT = "<limit lower='-1' upper='2' effort='5' velocity='3'/>"


def read(text: str, **options) -> Scene:
    return Scene.from_read(read_urdf_string(text, **options), "test")


@pytest.mark.parametrize(
    ("urdf_type", "mujoco_types"),
    [
        ("revolute", [mujoco.mjtJoint.mjJNT_HINGE]),
        ("continuous", [mujoco.mjtJoint.mjJNT_HINGE]),
        ("prismatic", [mujoco.mjtJoint.mjJNT_SLIDE]),
        ("spherical", [mujoco.mjtJoint.mjJNT_BALL]),
        ("floating", [mujoco.mjtJoint.mjJNT_FREE]),
        ("fixed", []),
        ("planar", [mujoco.mjtJoint.mjJNT_SLIDE] * 2 + [mujoco.mjtJoint.mjJNT_HINGE]),
    ],
)
def test_joint_types(urdf_type: str, mujoco_types: list) -> None:
    scene = read(two_links(type=urdf_type))
    assert list(scene.model.jnt_type) == mujoco_types


def test_planar_joint_moves_in_its_plane() -> None:
    scene = read(two_links("<axis xyz='1 2 3'/>", type="planar"))
    normal = np.array([1, 2, 3]) / np.sqrt(14)
    x, y, turn = scene.model.jnt_axis
    np.testing.assert_allclose([x @ normal, y @ normal, x @ y], 0, atol=1e-15)
    np.testing.assert_allclose(np.cross(x, y), normal, atol=1e-15)
    np.testing.assert_allclose(turn, normal, atol=1e-15)


def test_floating_joint_below_a_moving_link_is_three_slides_and_a_ball() -> None:
    text = robot(
        link("a"), link("b"), link("c"), joint("j", "a", "b"), joint("f", "b", "c", type="floating")
    )
    scene = read(text)
    names = [scene.model.jnt(i).name for i in range(scene.model.njnt)]
    assert names == ["j", "f_TX", "f_TY", "f_TZ", "f_R"]
    data = mujoco.MjData(scene.model)
    data.qpos[:] = [0.3, 0.1, 0.2, 0.5, 0.5, 0.5, 0.5, 0.5]
    mujoco.mj_kinematics(scene.model, data)
    turn = data.body("b").xmat.reshape(3, 3)
    np.testing.assert_allclose(data.body("c").xpos, turn @ [0.1, 0.2, 0.5], atol=1e-12)


def test_limits_and_dynamics() -> None:
    scene = read(two_links(LIMIT, "<dynamics damping='0.3' friction='0.4'/>"))
    model = scene.model
    np.testing.assert_array_equal(model.jnt_range[0], [-1, 2])
    np.testing.assert_array_equal(model.jnt_actfrcrange[0], [-5, 5])
    assert model.jnt_limited[0]
    assert model.jnt_actfrclimited[0]
    assert (model.dof_damping[0], model.dof_frictionloss[0]) == (0.3, 0.4)
    assert [item.feature for item in scene.unsupported] == ["limit velocity"]


@pytest.mark.parametrize(
    ("limit", "type", "says"),
    [
        ("<limit upper='1' effort='1' velocity='1'/>", "revolute", "one limit of two"),
        ("<limit effort='1' velocity='1'/>", "revolute", "has no limits"),
        ("<limit lower='0' upper='0' effort='1' velocity='1'/>", "prismatic", "has no limits"),
        ("", "revolute", "has no limits"),
    ],
)
def test_missing_limits_leave_the_joint_free_and_say_so(limit: str, type: str, says: str) -> None:
    scene = read(two_links(limit, type=type))
    assert not scene.model.jnt_limited[0]
    assert any(says in warning for warning in scene.warnings)


def test_limits_of_a_continuous_joint_are_kept_as_in_mujoco_and_noted() -> None:
    scene = read(two_links(LIMIT, type="continuous"))
    assert scene.model.jnt_limited[0]
    assert any("is continuous and has limits" in warning for warning in scene.warnings)


def test_mimic_chain_holds_in_simulation() -> None:
    text = robot(
        *(link(name) for name in "abcd"),
        joint("lead", "a", "b", LIMIT, "<axis xyz='0 0 1'/>"),
        joint("follow", "b", "c", LIMIT, "<mimic joint='lead' multiplier='-2' offset='0.1'/>"),
        joint("last", "c", "d", "<mimic joint='follow' multiplier='0.5'/>", type="prismatic"),
    )
    model = read(text).model
    assert list(model.eq_type) == [mujoco.mjtEq.mjEQ_JOINT] * 2
    np.testing.assert_array_equal(model.eq_data[:, :5], [[0.1, -2, 0, 0, 0], [0, 0.5, 0, 0, 0]])
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0
    data.qfrc_applied[0] = 0.2
    for _ in range(2000):
        mujoco.mj_step(model, data)
    assert data.qpos[0] > 0.05
    np.testing.assert_allclose(data.qpos[1], 0.1 - 2 * data.qpos[0], atol=2e-3)
    np.testing.assert_allclose(data.qpos[2], 0.5 * data.qpos[1], atol=2e-3)


def test_mimic_of_a_fixed_joint_holds_the_offset() -> None:
    text = robot(
        *(link(name) for name in "abc"),
        joint("still", "a", "b", type="fixed"),
        joint("j", "b", "c", "<mimic joint='still' multiplier='3' offset='0.2'/>"),
    )
    model = read(text).model
    assert model.eq_obj2id[0] == -1
    assert model.eq_data[0, 0] == 0.2


def test_mimic_of_a_planar_joint_is_listed() -> None:
    text = robot(
        *(link(name) for name in "abc"),
        joint("p", "a", "b", type="planar"),
        joint("j", "b", "c", "<mimic joint='p'/>", type="continuous"),
    )
    scene = read(text)
    assert scene.model.neq == 0
    assert "mimic" in [item.feature for item in scene.unsupported]


def test_fixed_links_are_lumped_unless_asked_not_to() -> None:
    text = robot(
        link("a"),
        link("b"),
        link("tool", inertial(3.0), collision("<sphere radius='0.1'/>")),
        joint("j", "a", "b"),
        joint("weld", "b", "tool", "<origin xyz='1 0 0'/>", type="fixed"),
    )
    lumped, kept = read(text), read(text, lump_fixed=False)
    assert [lumped.model.body(i).name for i in range(lumped.model.nbody)] == ["world", "b"]
    assert [kept.model.body(i).name for i in range(kept.model.nbody)] == ["world", "a", "b", "tool"]
    assert lumped.model.body("b").mass == pytest.approx(4.0)
    np.testing.assert_allclose(lumped.model.body("b").ipos, [0.75, 0, 0])
    np.testing.assert_allclose(lumped.model.geom_pos[0], [1, 0, 0])
    assert any("tool" in warning and "lump_fixed" in warning for warning in lumped.warnings)


def test_floating_base() -> None:
    scene = read(two_links(), floating_base=True)
    assert scene.model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert scene.model.jnt(0).name == "a_free_joint"
    assert scene.model.body("a").mass == 1.0
    with pytest.raises(SceneError, match="the world, which cannot float"):
        read(two_links().replace("'a'", "'world'"), floating_base=True)


def test_root_link_named_world_is_the_world() -> None:
    model = read(two_links().replace("'a'", "'world'")).model
    assert [model.body(i).name for i in range(model.nbody)] == ["world", "b"]


def test_extension_of_mujoco() -> None:
    settings = (
        "<mujoco><compiler fusestatic='false' discardvisual='true' boundmass='0.5' "
        "boundinertia='0.01'/><option timestep='0.004' gravity='0 0 -1'/><asset/></mujoco>"
    )
    text = robot(
        settings,
        link("a"),
        link("b", visual("<box size='1 1 1'/>")),
        joint("j", "a", "b"),
    )
    scene = read(text)
    assert scene.model.opt.timestep == 0.004
    assert scene.model.ngeom == 0
    assert scene.model.nbody == 3
    assert scene.model.body("b").mass == 0.5
    assert any("<asset>" in item.element for item in scene.unsupported)
    with pytest.raises(SceneError, match="<mujoco> extension"):
        read(robot("<mujoco><option timestep='soon'/></mujoco>", link("a")))


def test_unknown_elements_are_listed_once_for_each_kind() -> None:
    text = robot(
        link("a", inertial(), "<contact><lateral_friction value='1'/></contact>"),
        link("b", inertial(), "<contact/>"),
        joint(
            "j", "a", "b", LIMIT, "<safety_controller k_velocity='10'/><calibration rising='0'/>"
        ),
        "<gazebo/><gazebo reference='a'/><sensor name='s'/><ros2_control name='c'/>",
        "<transmission name='t'><joint name='j'/><actuator name='m'/></transmission>",
    )
    features = [item.feature for item in read(text).unsupported]
    expected = {
        "<contact> in <link>",
        "<safety_controller> in <joint>",
        "<calibration> in <joint>",
        "<gazebo> in <robot>",
        "<sensor> in <robot>",
        "<ros2_control> in <robot>",
        "<transmission>",
        "limit velocity",
    }
    assert set(features) == expected
    assert len(features) == len(expected)


def test_prefixed_elements_need_no_declaration() -> None:
    scene = read(robot(link("a"), "<sensor:camera name='c'/>"))
    assert [item.feature for item in scene.unsupported] == ["<sensor:camera> in <robot>"]


def test_options_are_checked() -> None:
    with pytest.raises(UnknownNameError, match="floating_base"):
        read(two_links(), floating_bas=True)
    with pytest.raises(InputError, match="actuators='torque': expected"):
        read(two_links(), actuators="torque")
    with pytest.raises(InputError, match="position_gain=-1"):
        read(two_links(), position_gain=-1)


def test_options_reach_the_reader_through_load_scene(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_text(two_links())
    assert load_scene(file).model.nbody == 2
    assert load_scene(file, lump_fixed=False).model.nbody == 3
    assert load_scene(file.read_text(), floating_base=True).model.nq == 8
    with pytest.raises(UnknownNameError):
        load_scene(file, lump=False)


def test_missing_yourdfpy_is_reported_as_such(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    real = builtins.__import__

    def without(name: str, *rest, **kinds):
        if name == "yourdfpy":
            raise ImportError("No module named 'yourdfpy'")
        return real(name, *rest, **kinds)

    monkeypatch.setattr(builtins, "__import__", without)
    file = tmp_path / "r.urdf"
    file.write_text(two_links())
    with pytest.raises(MissingDependencyError, match=r"orbisim\[urdf\]"):
        load_scene(file)


def test_a_file_that_ends_like_a_c_string_loads(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes(two_links().encode() + b"\r\n\0")
    assert load_scene(path).model.njnt == 1


def test_a_robot_without_a_name_is_called_robot() -> None:
    assert read(two_links().replace(" name='r'", "", 1)).name == "robot"


def test_order_of_degrees_of_freedom_follows_the_tree_as_in_mujocos_import() -> None:
    text = robot(
        *(link(name) for name in ("a", "tool", "b", "c")),
        joint("weld", "a", "tool", type="fixed"),
        joint("first", "a", "b"),
        joint("second", "tool", "c"),
    )
    ours = read(text).model
    theirs = mujoco.MjSpec.from_string(text).compile()
    names = [[m.jnt(i).name for i in range(m.njnt)] for m in (ours, theirs)]
    assert names[0] == names[1]


def test_long_chains_load() -> None:
    count = 300
    text = robot(
        *(link(f"l{i}") for i in range(count)),
        *(
            joint(f"j{i}", f"l{i}", f"l{i + 1}", "<origin xyz='0.1 0 0'/>")
            for i in range(count - 1)
        ),
    )
    assert read(text).model.njnt == count - 1
