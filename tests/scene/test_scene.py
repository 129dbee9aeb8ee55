"""Scenes: saved, edited, described."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from dm_control import suite as dm_suite

from orbisim import Scene, load_scene
from orbisim.errors import InputError, SceneError, UnknownNameError
from orbisim.scene.tensors import columns, from_tensors, to_tensors

from .test_mjcf import EVERYTHING

SUITE = Path(dm_suite.__file__).parent


UNUSED = {"geom_size", "site_size"}  # the writer leaves out what a type does not use
USED = {"plane": 3, "sphere": 1, "capsule": 2, "ellipsoid": 3, "cylinder": 2, "box": 3}


def assert_same_model(a: mujoco.MjModel, b: mujoco.MjModel, atol: float) -> None:
    for geom in range(a.ngeom):
        used = USED.get(mujoco.mjtGeom(a.geom_type[geom]).name[7:].lower(), 0)
        np.testing.assert_allclose(a.geom_size[geom, :used], b.geom_size[geom, :used], rtol=1e-9)
    for name in dir(a):
        x = getattr(a, name)
        if name.startswith("_") or not isinstance(x, np.ndarray) or name.endswith("pathadr"):
            continue
        if name in UNUSED:
            continue
        np.testing.assert_allclose(
            np.asarray(x, float), np.asarray(getattr(b, name), float), rtol=1e-9, atol=atol,
            err_msg=name,
        )  # fmt: skip


@pytest.mark.parametrize("name", ["cheetah", "humanoid_CMU", "dog", "quadruped"])
def test_a_saved_scene_is_the_same_scene(tmp_path: Path, name: str) -> None:
    scene = load_scene(SUITE / f"{name}.xml")
    path = scene.save(tmp_path / "here")
    shutil.move(tmp_path / "here", tmp_path / "there")  # it can be moved
    saved = mujoco.MjModel.from_xml_path(str(tmp_path / "there" / path.name))
    assert_same_model(saved, scene.model, 1e-6)


def test_saving_keeps_seventeen_digits(tmp_path: Path) -> None:
    body = "<body pos='0.12345678901234567 0 0'><geom size='1'/></body>"
    scene = load_scene(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    again = load_scene(scene.save(tmp_path))
    assert again.model.body_pos[1, 0] == 0.12345678901234567
    assert "0.1234567890123456" in scene.to_xml()


def test_saving_everything(tmp_path: Path) -> None:
    scene = load_scene(EVERYTHING)
    again = load_scene(scene.save(tmp_path, "model.xml"))
    assert_same_model(again.model, scene.model, 1e-9)


def test_two_files_of_one_name_are_both_kept(tmp_path: Path) -> None:
    for folder, size in (("a", 1.0), ("b", 2.0)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "m.obj").write_text(
            f"v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nv 0 0 {size}\n"
            "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
        )
    (tmp_path / "s.xml").write_text(
        "<mujoco><asset><mesh name='a' file='a/m.obj'/><mesh name='b' file='b/m.obj'/></asset>"
        "<worldbody><geom type='mesh' mesh='a'/><geom type='mesh' mesh='b'/></worldbody></mujoco>"
    )
    scene = load_scene(tmp_path / "s.xml")
    saved = scene.save(tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out" / "assets").iterdir()) == ["m.obj", "m_2.obj"]
    assert_same_model(load_scene(saved).model, scene.model, 1e-9)


def test_a_lost_file_is_named(tmp_path: Path) -> None:
    obj = tmp_path / "m.obj"
    obj.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (tmp_path / "s.xml").write_text(
        "<mujoco><asset><mesh name='a' file='m.obj'/></asset>"
        "<worldbody><geom type='mesh' mesh='a'/></worldbody></mujoco>"
    )
    scene = load_scene(tmp_path / "s.xml")
    obj.unlink()
    with pytest.raises(SceneError, match=r"m\.obj"):
        scene.save(tmp_path / "out")


def test_editing_a_copy() -> None:
    scene = load_scene(EVERYTHING)
    spec = scene.spec
    spec.option.gravity = [0, 0, -1]
    assert Scene.from_spec(spec).model.opt.gravity[2] == -1
    assert load_scene(EVERYTHING).fingerprint == scene.fingerprint
    assert Scene.from_spec(spec).fingerprint != scene.fingerprint
    assert scene.model.opt.gravity[2] == -9.81


def test_a_compiled_model_has_no_document() -> None:
    scene = Scene.from_model(load_scene(EVERYTHING).model)
    assert not scene.editable
    with pytest.raises(InputError, match="cannot be edited"):
        _ = scene.spec


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


def test_surfaces_lie_on_the_mesh() -> None:
    descriptor = load_scene(EVERYTHING).descriptor
    surface = descriptor.entity("free").geometries[0].surface
    assert surface is not None
    # three right triangles of legs 0.1 and one equilateral of side 0.1 sqrt 2
    assert surface.area == pytest.approx(3 * 0.005 + np.sqrt(3) / 4 * 0.02, rel=1e-4)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    hills = next(g for e in descriptor.entities for g in e.geometries if g.name == "ground")
    assert hills.surface is not None
    assert hills.surface.points[:, 2].max() <= 0.3 + 1e-6


@pytest.mark.parametrize("source", [EVERYTHING, str(SUITE / "dog.xml"), str(SUITE / "stacker.xml")])
def test_descriptors_survive_tensors(source: str) -> None:
    descriptor = load_scene(source).descriptor
    tensors = to_tensors(descriptor)
    zeros = {name: np.zeros_like(table) for name, table in tensors.items()}
    blank = from_tensors(zeros, descriptor)
    assert blank != descriptor
    assert from_tensors(tensors, blank) == descriptor
    for name in ("part", "geometry", "joint", "actuator", "world"):
        assert tensors[name].shape[1] == len(columns(name))


def test_tensors_of_another_scene_are_refused() -> None:
    descriptor = load_scene(EVERYTHING).descriptor
    other = to_tensors(load_scene(SUITE / "cheetah.xml").descriptor)
    with pytest.raises(InputError, match="has shape"):
        from_tensors(other, descriptor)
    with pytest.raises(InputError, match="lack"):
        from_tensors({}, descriptor)


def test_task_names() -> None:
    scene = load_scene("suite:cheetah-run")
    assert scene.model.nv == 9
    assert scene.source == "suite:cheetah-run"
    with pytest.raises(UnknownNameError, match="did you mean 'cheetah-run'"):
        load_scene("suite:cheetah-runn")
