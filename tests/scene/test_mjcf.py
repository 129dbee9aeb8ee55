"""MJCF goes through unchanged: the same model, the same steps, the same errors, said better."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from dm_control import suite as dm_suite

from orbisim import load_scene, make_backend
from orbisim.errors import InputError, SceneError
from orbisim.scene.scene import model_bytes

SUITE = Path(dm_suite.__file__).parent
FILES = sorted(path.name for path in SUITE.glob("*.xml"))
EVERYTHING = """
<mujoco model="everything">
  <compiler angle="radian"/>
  <option timestep="0.003" density="1.2" wind="1 0 0"/>
  <asset>
    <mesh name="tetra" vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.1"/>
    <hfield name="hills" nrow="4" ncol="5" size="1 2 0.3 0.1"
            elevation="0 1 2 3 4 5 4 3 2 1 0 1 2 3 4 5 4 3 2 1"/>
    <material name="m" rgba="1 0 0 1"/>
  </asset>
  <default><geom solref="0.01 1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <geom name="ground" type="hfield" hfield="hills" pos="5 0 0"/>
    <body name="free" pos="0 0 1"><freejoint/><geom type="mesh" mesh="tetra" material="m"/></body>
    <body name="mocap" mocap="true"><geom size="0.1" contype="0" conaffinity="0"/></body>
    <body name="arm" pos="1 0 1">
      <joint name="ball" type="ball" range="0 1" damping="0.1 0.02"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <site name="tip" pos="0.3 0 0"/>
      <body pos="0.3 0 0"><joint name="elbow" axis="0 1 0" range="-1 1" frictionloss="0.1"
             springref="0.2" stiffness="1 0 0.5"/>
        <geom type="ellipsoid" size="0.05 0.06 0.07"/></body>
    </body>
  </worldbody>
  <tendon><fixed name="t"><joint joint="elbow" coef="0.5"/></fixed></tendon>
  <actuator>
    <position name="p" joint="elbow" kp="10" ctrlrange="-1 1" forcerange="-5 5" delay="0.006"
              nsample="3"/>
    <motor name="by_tendon" tendon="t" gear="2"/>
    <dcmotor name="dc" joint="elbow" input="none" motorconst="1e-9" resistance="1"
             cogging="0.1 4 0.2"/>
  </actuator>
  <equality><joint joint1="elbow" polycoef="0 1 0 0 0" active="false"/></equality>
  <sensor><framepos objtype="site" objname="tip"/><touch site="tip"/></sensor>
  <keyframe><key name="home" time="1"/></keyframe>
  <custom><text name="note" data="kept"/></custom>
</mujoco>
"""


@pytest.mark.parametrize("name", FILES)
def test_the_suites_scenes_are_compiled_as_mujoco_does(name: str) -> None:
    scene = load_scene(SUITE / name)
    assert model_bytes(scene.model) == model_bytes(mujoco.MjModel.from_xml_path(str(SUITE / name)))
    assert scene.unsupported == ()


def test_steps_equal_mujocos_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "everything.xml"
    path.write_text(EVERYTHING)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    controls = np.random.default_rng(0).uniform(-1, 1, (300, model.nu))
    backend = make_backend("mujoco", load_scene(path))
    ours = backend.rollout(backend.reset(), controls)
    for t in range(300):
        data.ctrl[:] = controls[t]
        mujoco.mj_step(model, data)
        np.testing.assert_array_equal(ours.qpos[0, t], data.qpos)
        np.testing.assert_array_equal(ours.qvel[0, t], data.qvel)
        np.testing.assert_array_equal(ours.sensordata[0, t], data.sensordata)


def test_a_string_with_assets() -> None:
    cube = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    xml = (
        "<mujoco><asset><mesh name='c' file='c.obj'/></asset><worldbody>"
        "<geom type='mesh' mesh='c'/></worldbody></mujoco>"
    )
    scene = load_scene(xml, assets={"c.obj": cube.encode()})
    assert scene.model.mesh_vertnum[0] == 4


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        ("<mujoco><worldbody><geom size='0.1' colour='red'/></worldbody></mujoco>", "colour"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "mass and inertia"),
        ("<mujoco><worldbody><geom size='nan'/></worldbody></mujoco>", ""),
        ("<mujoco><worldbody><geom size='-1'/></worldbody></mujoco>", "size"),
        ("<mujoco><worldbody><geom type='mesh' mesh='x'/></worldbody></mujoco>", "mesh"),
        ("<mujoco><worldbody>", "XML"),
        ("<!DOCTYPE m [<!ENTITY a 'b'>]><mujoco/>", "entities"),
        ("<mujoco><actuator><motor joint='none'/></actuator></mujoco>", "none"),
        ("<mujoco><sensor><touch name='t' site='s'/></sensor></mujoco>", "unrecognized name"),
    ],
)
def test_errors_are_one_line(xml: str, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(xml)
    text = str(caught.value)
    assert "\n" not in text
    assert message in text
    assert text.startswith("XML string: ")


def test_errors_name_the_line() -> None:
    with pytest.raises(SceneError, match=r"line 3, <geom>"):
        load_scene("<mujoco>\n<worldbody>\n<geom size='0.1' colour='red'/>\n</worldbody></mujoco>")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xml", b"", "empty"),
        ("a.stl", b"x", "is a mesh, not a scene"),
        ("a.foo", b"x", "suffix"),
        ("a", b"x", "suffix"),
        ("a.urdf", b"<mujoco/>", "URDF starts with <robot>"),
        ("a.xml", b"<robot name='r'/>", "rename it to end in .urdf"),
        ("a.xml", b"\x00\x01\x02", "MuJoCo refuses it"),
    ],
)
def test_wrong_files(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path)
    assert caught.value.exit_status == 2


def test_missing_files_and_folders(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text("<mujoco/>")
    with pytest.raises(SceneError, match=r"did you mean '.*scene\.xml'"):
        load_scene(tmp_path / "scen.xml")
    with pytest.raises(SceneError, match="folder"):
        load_scene(tmp_path)


def test_assets_are_for_strings(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="assets"):
        load_scene(tmp_path / "x.xml", assets={})


def test_options_of_other_readers_are_refused() -> None:
    with pytest.raises(InputError, match="floating_base"):
        load_scene("<mujoco/>", floating_base=True)


def test_comments_may_speak_of_entities() -> None:
    assert load_scene("<!-- <!ENTITY a 'b'> --><mujoco/>").model.nbody == 1


def test_compiler_warnings_are_collected() -> None:
    scene = load_scene("<mujoco><compiler settotalmass='1'/><worldbody><body><freejoint/>"
                       "<geom size='1'/></body></worldbody></mujoco>")  # fmt: skip
    assert any("settotalmass" in warning for warning in scene.warnings)


def test_other_suffixes_with_includes(tmp_path: Path) -> None:
    """MuJoCo tells documents by `.xml`; ours may be called `.mjcf`."""
    (tmp_path / "options.xml").write_text("<mujoco><option timestep='0.004'/></mujoco>")
    text = "<mujoco model='m'><include file='options.xml'/><worldbody><geom size='1'/></worldbody>"
    path = tmp_path / "scene.mjcf"
    path.write_text(text + "</mujoco>")
    scene = load_scene(path)
    assert scene.model.opt.timestep == 0.004
    assert load_scene(scene.save(tmp_path / "saved")).fingerprint == scene.fingerprint
