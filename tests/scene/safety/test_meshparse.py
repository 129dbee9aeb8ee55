"""Meshes as their files have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbisim.scene.safety.meshparse import join, parse_mesh_file
from orbisim.scene.safety.problem import MeshProblemError

BOX = trimesh.creation.box((1, 2, 3))


def test_joined_meshes_keep_their_triangles() -> None:
    far = trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix([5, 0, 0]))
    both = join([BOX, far])
    assert both.volume == pytest.approx(7.0)
    np.testing.assert_array_equal(both.triangles, [*BOX.triangles, *far.triangles])


def test_a_node_that_mirrors_turns_its_faces(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(BOX, transform=np.diag([-1.0, 1, 1, 1]))
    scene.add_geometry(BOX, transform=trimesh.transformations.translation_matrix([9, 0, 0]))
    (tmp_path / "m.glb").write_bytes(scene.export(file_type="glb"))
    parts = parse_mesh_file(tmp_path / "m.glb").parts
    assert [part.mesh.volume for part in parts] == pytest.approx([6.0, 6.0])
    assert sorted(part.mesh.centroid[0] for part in parts) == pytest.approx([0, 9])


def test_colours(tmp_path: Path) -> None:
    red = trimesh.creation.box((1, 1, 1))
    red.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 0, 0, 255])
    )
    (tmp_path / "m.glb").write_bytes(trimesh.Scene(red).export(file_type="glb"))
    (part,) = parse_mesh_file(tmp_path / "m.glb").parts
    assert part.rgba == (1.0, 0.0, 0.0, 1.0)
    (tmp_path / "m.stl").write_bytes(BOX.export(file_type="stl"))
    assert parse_mesh_file(tmp_path / "m.stl").parts[0].rgba is None


def test_without_faces_it_is_the_hull(tmp_path: Path) -> None:
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in [*BOX.vertices, (0, 0, 0)])
    (tmp_path / "m.obj").write_text(corners)
    mesh = parse_mesh_file(tmp_path / "m.obj").joined()
    assert mesh.volume == pytest.approx(6.0)
    assert len(mesh.vertices) == 8


def test_images_are_noticed_and_not_loaded(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    )
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\nmap_Kd gone.png\n")
    assert parse_mesh_file(tmp_path / "m.obj").textured
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\n")
    assert not parse_mesh_file(tmp_path / "m.obj").textured


def test_whatever_a_parser_raises_the_file_is_broken(tmp_path: Path) -> None:
    (tmp_path / "m.glb").write_bytes(b"glTF" + bytes(40))
    with pytest.raises(MeshProblemError, match="cannot be read"):
        parse_mesh_file(tmp_path / "m.glb")
