"""Points on surfaces."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from orbisim import load_scene
from orbisim.scene.surface import hfield_triangles, mesh_triangles, sample_surface

from .test_mjcf import EVERYTHING


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


BOX = trimesh.creation.box((1, 2, 4))


def test_points_are_spread_by_area() -> None:
    surface = sample_surface(BOX.vertices, BOX.faces, 20_000)
    assert surface.area == pytest.approx(2 * (2 + 4 + 8))
    shares = [np.mean(np.abs(surface.normals[:, axis]) > 0.5) for axis in range(3)]
    np.testing.assert_allclose(shares, [16 / 28, 8 / 28, 4 / 28], atol=0.02)
    on_x = surface.points[np.abs(surface.normals[:, 0]) > 0.5]
    np.testing.assert_allclose(np.abs(on_x[:, 0]), 0.5)
    assert np.ptp(on_x[:, 2]) == pytest.approx(4, abs=0.01)


def test_normals_point_outward() -> None:
    surface = sample_surface(BOX.vertices, BOX.faces)
    assert ((surface.points * surface.normals).sum(1) > 0.4).all()


def test_the_same_arguments_give_the_same_points() -> None:
    first, again = (sample_surface(BOX.vertices, BOX.faces) for _ in range(2))
    assert first == again
    assert hash(first) == hash(again)
    assert first != sample_surface(BOX.vertices, BOX.faces, seed=1)
    with pytest.raises(ValueError, match="read-only"):
        first.points[0] = 0


def test_a_line_has_no_surface() -> None:
    line = sample_surface(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]), 5)
    assert line.area == 0.0
    assert not line.points.any()


def test_triangles_are_those_of_the_model() -> None:
    model = load_scene(EVERYTHING).model
    vertices, faces = mesh_triangles(model, 0)
    tetra = trimesh.Trimesh(vertices, faces)
    assert tetra.volume == pytest.approx(0.1**3 / 6, rel=1e-5)
    np.testing.assert_allclose(tetra.center_mass, 0, atol=1e-7)  # its inertial frame


def test_a_height_field_is_its_grid() -> None:
    model = load_scene(EVERYTHING).model
    vertices, faces = hfield_triangles(model, 0)
    grid = vertices.reshape(4, 5, 3)
    np.testing.assert_allclose(grid[0, :, 0], np.linspace(-1, 1, 5))
    np.testing.assert_allclose(grid[:, 0, 1], np.linspace(-2, 2, 4))
    top = trimesh.Trimesh(vertices, faces, process=False)
    assert len(faces) == 2 * 3 * 4
    assert (top.face_normals[:, 2] > 0).all()
    # elevation runs from 0 to 5 and is scaled to the height of 0.3, first row first
    rows = np.array([0, 1, 2, 3, 4, 5, 4, 3, 2, 1, 0, 1, 2, 3, 4, 5, 4, 3, 2, 1]).reshape(4, 5)
    in_model = model.hfield_data.reshape(4, 5)
    np.testing.assert_allclose(grid[..., 2], 0.3 * in_model, atol=1e-7)
    np.testing.assert_allclose(np.sort(in_model.ravel()), np.sort(rows.ravel() / 5), atol=1e-6)
