"""USD: MuJoCo's own attributes, against the same model in MJCF."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene import Scene, load_scene
from tests.scene.usd.usd_text import DATA, stage, write

SKIPPED = {
    "signature", "names", "paths", "names_map", "exclude_signature",
    "nbuffer", "nnames", "npaths", "nnames_map",
    "geom_size",  # compared below: a plane's size is for the eye
    "jnt_group", "actuator_ctrlspec",
}  # fmt: skip


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(DATA / "mujoco.usda")


@pytest.fixture(scope="module")
def expected() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(DATA / "mujoco.xml"))


def numeric_fields(model: mujoco.MjModel) -> list[str]:
    return [
        name
        for name in dir(model)
        if not name.startswith(("_", "name_", "vis", "stat", "opt"))
        and name not in SKIPPED
        and isinstance(getattr(model, name), int | float | np.ndarray)
    ]


def test_every_number_is_that_of_the_mjcf(scene: Scene, expected: mujoco.MjModel) -> None:
    fields = numeric_fields(expected)
    assert len(fields) > 200
    for name in fields:
        np.testing.assert_allclose(
            getattr(scene.model, name), getattr(expected, name), rtol=1e-9, atol=1e-12,
            err_msg=name,
        )  # fmt: skip
    for name in dir(expected.opt):
        if not name.startswith("_"):
            np.testing.assert_array_equal(
                getattr(scene.model.opt, name), getattr(expected.opt, name), name
            )
    moving = expected.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
    np.testing.assert_allclose(scene.model.geom_size[moving], expected.geom_size[moving])


def test_every_name_is_that_of_the_mjcf(scene: Scene, expected: mujoco.MjModel) -> None:
    for kind in ("body", "joint", "geom", "site", "tendon", "actuator", "equality", "key"):
        count = getattr(expected, {"body": "nbody", "joint": "njnt", "geom": "ngeom",
                                   "site": "nsite", "tendon": "ntendon", "actuator": "nu",
                                   "equality": "neq", "key": "nkey"}[kind])  # fmt: skip
        found = [getattr(scene.model, kind)(i).name for i in range(count)]
        assert found == [getattr(expected, kind)(i).name for i in range(count)]


def test_both_move_alike(scene: Scene, expected: mujoco.MjModel) -> None:
    states = []
    for model in (scene.model, expected):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(500):
            mujoco.mj_step(model, data)
        states.append(data.qpos.copy())
    np.testing.assert_allclose(states[0], states[1], atol=1e-9)


def test_only_the_keyframe_that_does_not_fit_is_missing(scene: Scene) -> None:
    assert [entry.element for entry in scene.unsupported] == ["/arm/Physics/misfit"]
    assert "3 numbers in mjc:qpos (the model has 10)" in str(scene.unsupported[0])


def edited(tmp_path: Path, old: str, new: str) -> Path:
    text = (DATA / "mujoco.usda").read_text()
    assert old in text
    return write(tmp_path, text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('mjc:option:cone = "elliptic"', 'mjc:option:cone = "round"', "expected one of pyramidal"),
        ("newton:timeStepsPerSecond = 250", "newton:timeStepsPerSecond = 0", "is 0; expected"),
        ("[0.01, 0.9]", "[0.01, 0.9, 1, 2, 3, 4]", "mjc:solref holds 6 numbers"),
        ("mjc:condim = 4", "mjc:condim = 2", "condim"),
        ("[0, 1, 2, 2, 3]", "[0, 1, 2, 2, 9]", "mjc:path:indices leads beyond"),
        ("</arm/Geometry/upper/shoulder>\n            uniform double[] mjc:gear",
         "</arm/Nowhere>\n            uniform double[] mjc:gear", "leads to </arm/Nowhere>"),
    ],
)  # fmt: skip
def test_attributes_that_make_no_sense(tmp_path: Path, old: str, new: str, problem: str) -> None:
    with pytest.raises(SceneError, match=problem):
        load_scene(edited(tmp_path, old, new))


def test_actuators_and_tendons_without_a_target_are_listed(tmp_path: Path) -> None:
    path = edited(tmp_path, "rel mjc:target = </arm/Physics/rope>", "")
    text = path.read_text().replace("</arm/Geometry/upper/s1>, </arm", "</arm/Physics>, </arm")
    scene = load_scene(write(tmp_path, text.replace("double[] mjc:ctrl = [1, 2, 3, 4, 5]", "")))
    listed = " ".join(str(entry) for entry in scene.unsupported)
    assert "MjcActuator whose target is nothing" in listed
    assert "MjcTendon along </arm/Physics>" in listed
    assert scene.model.nu == 4 and scene.model.ntendon == 1


def test_old_attributes_of_the_schema(tmp_path: Path) -> None:
    """Before Newton's schema, MuJoCo's held the time step, damping, friction and margins."""
    body = """
    def Material "M" (prepend apiSchemas = ["PhysicsMaterialAPI", "MjcMaterialAPI"])
    {
        float physics:dynamicFriction = 0.8
        uniform double mjc:torsionalfriction = 0.1
        uniform double mjc:rollingfriction = 0.2
    }
    def Cube "B" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "MjcCollisionAPI",
                              "MaterialBindingAPI"]
    )
    {
        rel material:binding:physics = </M>
        uniform double mjc:margin = 0.01
        uniform double mjc:gap = 0.02
        uniform bool mjc:shellinertia = 1
    }
    def PhysicsRevoluteJoint "J" (prepend apiSchemas = ["MjcJointAPI"])
    {
        rel physics:body1 = </B>
        uniform double mjc:damping = 0.5
        uniform double mjc:armature = 0.25
        uniform double mjc:frictionloss = 0.125
    }
    """
    text = stage(body).replace(
        'def PhysicsScene "Physics"\n{',
        'def PhysicsScene "Physics" (prepend apiSchemas = ["MjcSceneAPI"])\n{\n'
        "uniform double mjc:option:timestep = 0.003",
    )
    model = load_scene(write(tmp_path, text)).model
    assert model.opt.timestep == 0.003
    np.testing.assert_allclose(model.geom_friction[0], [0.8, 0.1, 0.2])
    assert (model.geom_margin[0], model.geom_gap[0]) == (0.01, 0.02)
    assert (model.dof_damping[0], model.dof_armature[0], model.dof_frictionloss[0]) == (
        0.5,
        0.25,
        0.125,
    )
    # 1000 kg/m^2 on a cube of 2 m: a shell of 24 m^2
    assert model.body("B").mass[0] == pytest.approx(24000)
