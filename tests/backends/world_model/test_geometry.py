"""Shapes as points with normals, and as tokens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from orbisim_world_model.geometry import (
    CENTRES,
    NEIGHBOURS,
    POINTS,
    TOKEN,
    DistanceHead,
    GeometryEncoder,
    GeometryTokens,
    farthest,
    load_encoder,
    mesh_hash,
    neighbourhoods,
    save_encoder,
    surface_points,
)


def box(*size: float) -> trimesh.Trimesh:
    return trimesh.creation.box(size)


def test_points_lie_on_the_surface_with_outward_normals() -> None:
    mesh = box(0.2, 0.4, 0.6)
    mesh.apply_translation([1.0, 2.0, 3.0])
    cloud = surface_points(mesh)
    assert cloud.points.shape == (POINTS, 6)
    np.testing.assert_allclose(cloud.centre, [1, 2, 3], atol=1e-12)
    places = cloud.points[:, :3] * cloud.size
    over = np.abs(places) / [0.1, 0.2, 0.3]
    np.testing.assert_allclose(over.max(axis=1), 1.0, atol=1e-5)
    assert ((places * cloud.points[:, 3:]).sum(axis=1) > 0).all()
    np.testing.assert_array_equal(cloud.points, surface_points(mesh).points)


def test_a_mesh_without_a_surface_is_refused() -> None:
    with pytest.raises(ValueError, match="a mesh with a surface"):
        surface_points(trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]]))


def test_centres_lie_far_apart() -> None:
    places = torch.rand(2, 200, 3, generator=torch.Generator().manual_seed(0))
    chosen = farthest(places, CENTRES)
    assert all(len(set(row.tolist())) == CENTRES for row in chosen)
    picked = places[0, chosen[0]]
    gap = torch.cdist(places[0], picked).amin(dim=1).max()
    apart = torch.cdist(picked, picked).fill_diagonal_(torch.inf).min()
    assert gap <= apart + 1e-6  # no point is farther from all centres than centres are apart


def test_features_do_not_depend_on_the_order_of_points() -> None:
    torch.manual_seed(0)
    encoder = GeometryEncoder().eval()
    points = torch.from_numpy(surface_points(box(0.1, 0.2, 0.3)).points)[None]
    order = torch.cat([torch.zeros(1, dtype=torch.long), 1 + torch.randperm(POINTS - 1)])
    with torch.no_grad():
        torch.testing.assert_close(encoder(points), encoder(points[:, order]), atol=1e-5, rtol=1e-5)


def test_centres_see_the_points_nearest_to_them() -> None:
    points = torch.from_numpy(surface_points(box(0.1, 0.2, 0.3)).points)[None]
    around, centres = neighbourhoods(points)
    assert around.shape == (1, CENTRES, NEIGHBOURS, 9) and centres.shape == (1, CENTRES, 3)
    gaps = around[0, :, :, :3].norm(dim=-1)
    nearest = torch.cdist(centres[0], points[0, :, :3]).sort(dim=1).values[:, :NEIGHBOURS]
    torch.testing.assert_close(gaps.sort(dim=1).values, nearest, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(around[0, :, :, 3:6] - centres[0, :, None], around[0, :, :, :3])


def test_a_mesh_is_encoded_once() -> None:
    tokens = GeometryTokens(GeometryEncoder())
    first = tokens(box(0.1, 0.2, 0.3))
    assert first.shape == (TOKEN,) and len(tokens) == 1
    np.testing.assert_array_equal(tokens(box(0.1, 0.2, 0.3)), first)
    assert len(tokens) == 1
    tokens(box(0.1, 0.2, 0.31))
    assert len(tokens) == 2
    assert mesh_hash(box(0.1, 0.2, 0.3)) != mesh_hash(box(0.1, 0.2, 0.31))


def test_it_learns_the_distance_of_a_plane_and_is_read_back(tmp_path: Path) -> None:
    torch.manual_seed(0)
    encoder, head = GeometryEncoder(), DistanceHead()
    points = torch.from_numpy(surface_points(box(0.4, 0.4, 0.02)).points)[None]
    queries = 0.5 * torch.randn(1, 256, 3)
    weights = [*encoder.parameters(), *head.parameters()]
    optimizer, losses = torch.optim.Adam(weights, lr=3e-3), list[float]()
    for _ in range(25):
        loss = (head(encoder(points), queries)[..., 0] - queries[..., 2].abs()).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]
    save_encoder(encoder, tmp_path / "geometry.safetensors")
    again = load_encoder(tmp_path / "geometry.safetensors")
    torch.testing.assert_close(again(points), encoder(points), atol=2e-2, rtol=2e-2)
    assert (tmp_path / "geometry.safetensors").stat().st_size < 2**20
