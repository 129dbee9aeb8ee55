"""Scenes written with the files that they need."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from dm_control import suite as dm_suite

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.scene.saving import packed, unpacked

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


@pytest.mark.parametrize(
    "name",
    [
        "cheetah",
        "humanoid_CMU",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("quadruped", "dog")),
    ],
)
def test_a_saved_scene_is_the_same_scene(tmp_path: Path, name: str) -> None:
    scene = load_scene(SUITE / f"{name}.xml")
    path = scene.save(tmp_path / "here")
    shutil.move(tmp_path / "here", tmp_path / "there")  # it can be moved
    saved = mujoco.MjModel.from_xml_path(str(tmp_path / "there" / path.name))
    assert_same_model(saved, scene.model, 1e-6)


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


def test_a_packed_document_needs_no_files(tmp_path: Path) -> None:
    obj = tmp_path / "m.obj"
    obj.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (tmp_path / "s.xml").write_text(
        "<mujoco><asset><mesh name='a' file='m.obj'/></asset>"
        "<worldbody><geom type='mesh' mesh='a'/></worldbody></mujoco>"
    )
    scene = load_scene(tmp_path / "s.xml")
    xml, assets = packed(scene.spec, scene.source)
    assert list(assets.values()) == [obj.read_bytes()]
    obj.unlink()
    assert_same_model(unpacked(xml, assets).compile(), scene.model, 0.0)
