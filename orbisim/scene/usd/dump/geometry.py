"""Meshes: validated, triangulated, oriented."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from pxr import UsdGeom  # type: ignore[import-untyped,unused-ignore]

from orbisim.errors import SceneError
from orbisim.scene.usd.dump.xforms import TIME
from orbisim.scene.usd.flat import FlatMesh, Float32Array, IntArray


class MeshPool:
    """Collects meshes and holds equal ones once."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._index: dict[bytes, int] = {}
        self.meshes: list[FlatMesh] = []

    def add(self, prim: Any) -> int:
        """Index of the prim's mesh; -1 if it has no points or no faces.

        Raises:
          SceneError: the topology does not fit the points, or a point is not finite.
        """
        points, counts, indices = _arrays(UsdGeom.Mesh(prim))
        if not len(points) or not len(counts):
            return -1
        problem = _problem(points, counts, indices)
        if problem:
            raise SceneError(self._source, problem, element=str(prim.GetPath()))
        left_handed = UsdGeom.Mesh(prim).GetOrientationAttr().Get(TIME) == "leftHanded"
        triangles = triangulate(counts, indices)
        if left_handed:
            triangles = triangles[:, ::-1]
        subsets = len(UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)))
        mesh = FlatMesh(points, np.ascontiguousarray(triangles), subsets)
        key = hashlib.sha256(mesh.points.tobytes() + b"|" + mesh.triangles.tobytes()).digest()
        if key not in self._index:
            self._index[key] = len(self.meshes)
            self.meshes.append(mesh)
        return self._index[key]


def _arrays(mesh: Any) -> tuple[Float32Array, IntArray, IntArray]:
    points = np.array(mesh.GetPointsAttr().Get(TIME) or [], np.float32).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(TIME) or [], np.int32)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get(TIME) or [], np.int32)
    return points, counts, indices


def _problem(points: Float32Array, counts: IntArray, indices: IntArray) -> str:
    """What is wrong with a mesh, or ""."""
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        return f"points[{bad[0]}] is {points[bad[0]].tolist()}; coordinates must be finite"
    if counts.min() < 3:
        return f"faceVertexCounts holds {counts.min()}; a face has at least 3 vertices"
    total = int(counts.sum(dtype=np.int64))
    if total != len(indices):
        return (
            f"faceVertexCounts adds up to {total} face vertices, "
            f"faceVertexIndices holds {len(indices)}"
        )
    if indices.min() < 0 or indices.max() >= len(points):
        wrong = indices.min() if indices.min() < 0 else indices.max()
        return f"faceVertexIndices holds {wrong}; the mesh has {len(points)} points"
    return ""


def triangulate(counts: IntArray, indices: IntArray) -> IntArray:
    """Fans of triangles, [m, 3], from polygons given by vertex counts and indices."""
    starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)[:-1]])
    fans = counts.astype(np.int64) - 2
    face = np.repeat(np.arange(len(counts)), fans)
    first_of_fan = np.concatenate([[0], np.cumsum(fans)[:-1]])
    step = np.arange(len(face)) - first_of_fan[face]
    corner = starts[face]
    picks = np.stack([corner, corner + step + 1, corner + step + 2], axis=1)
    return np.asarray(indices[picks], np.int32)
