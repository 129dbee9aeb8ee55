"""The files that MJCF documents refer to."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.scene.files import content, embed, file_references
from orbisim.scene.mjcf_files import documents

CHILD = """<mujoco model="child"><compiler meshdir="meshes"/>
<asset><mesh name="m" file="m.stl"/></asset>
<worldbody><body name="c"><joint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
MAIN = """<mujoco><compiler meshdir="assets"/><include file="more/part.xml"/>
<asset><mesh name="m" file="m.stl"/><model name="child" file="child/child.xml"/></asset>
<worldbody><body name="a"><joint/><geom type="mesh" mesh="m"/></body>
<body name="b"><joint/><geom type="mesh" mesh="n"/></body>
<body name="h"><attach model="child" body="c" prefix="x_"/></body></worldbody></mujoco>"""
PART = """<mujoco><asset><mesh name="n" file="n.stl"/></asset></mujoco>"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A document that includes one and attaches another, each with its mesh."""
    meshes = {"assets/m.stl": 1, "more/n.stl": 2, "child/meshes/m.stl": 3}
    for name, edge in meshes.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        trimesh.creation.box((edge, 1, 1)).export(tmp_path / name)
    (tmp_path / "main.xml").write_text(MAIN)
    (tmp_path / "more" / "part.xml").write_text(PART)
    (tmp_path / "child" / "child.xml").write_text(CHILD)
    return tmp_path / "main.xml"


def masses(model: mujoco.MjModel) -> list[float]:
    return [float(model.body(name).mass[0]) for name in ("a", "b", "x_c")]


def test_documents_are_found(scene: Path) -> None:
    found = [path.relative_to(scene.parent).as_posix() for path in documents(scene)]
    assert found == ["main.xml", "more/part.xml", "child/child.xml"]


def test_embedded_files_are_those_that_mujoco_reads(scene: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(scene))
    before = masses(spec.compile())
    np.testing.assert_allclose(before, [1000, 2000, 3000], rtol=1e-6)
    embed(spec, [path.parent for path in documents(scene)], "s")
    for file in scene.parent.rglob("*.stl"):
        file.unlink()
    assert masses(spec.compile()) == before
    assert len({reference.name for reference in file_references(spec)}) == 3


def test_included_and_attached_files_are_saved(scene: Path, tmp_path: Path) -> None:
    saved = load_scene(scene).save(tmp_path / "saved")
    for file in (scene.parent / "child").rglob("*.stl"):
        file.unlink()
    np.testing.assert_allclose(masses(load_scene(saved).model), [1000, 2000, 3000], rtol=1e-6)


def test_a_file_that_is_gone_is_named(scene: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(scene))
    (scene.parent / "assets" / "m.stl").unlink()
    reference = next(r for r in file_references(spec) if r.label == "mesh 'm'")
    with pytest.raises(SceneError, match=r"s: mesh 'm': the file 'm.stl' is gone; .*assets/m.stl"):
        content(spec, reference, [scene.parent], "s")


def test_broken_meshes_of_attached_documents_are_found(scene: Path) -> None:
    (scene.parent / "child" / "meshes" / "m.stl").write_bytes(b"\0" * 90)
    with pytest.raises(SceneError, match=r"mesh 'x_m': mesh file .*child/meshes/m.stl"):
        load_scene(scene)
