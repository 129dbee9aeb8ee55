"""Surface point clouds: how a mesh enters a descriptor."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

POINTS = 512
"""Points sampled from each surface."""


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Points sampled uniformly from a surface.

    Attributes:
      points: [n, 3] in the geom's frame, m.
      normals: [n, 3] unit outward normals.
      area: of the whole surface, m^2.
    """

    points: npt.NDArray[np.float64]
    normals: npt.NDArray[np.float64]
    area: float

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surface):
            return NotImplemented
        return (
            self.area == other.area
            and np.array_equal(self.points, other.points)
            and np.array_equal(self.normals, other.normals)
        )

    def __hash__(self) -> int:
        return hash((self.area, self.points.tobytes()))


def sample_surface(
    vertices: npt.NDArray[Any], faces: npt.NDArray[Any], count: int = POINTS, seed: int = 0
) -> Surface:
    """Samples a triangle mesh uniformly by area; the same arguments give the same points.

    Args:
      vertices: [nvert, 3]. faces: [nface, 3] indices into them.
    """
    import trimesh  # takes a second; scenes without meshes need none of it

    mesh = trimesh.Trimesh(np.asarray(vertices, float), np.asarray(faces), process=False)
    area = float(mesh.area)
    if not area > 0.0:  # degenerate: a point or a line
        return Surface(_frozen(np.zeros((count, 3))), _frozen(np.zeros((count, 3))), 0.0)
    points, face = trimesh.sample.sample_surface(mesh, count, seed=seed)[:2]
    normals = mesh.face_normals[face]
    return Surface(_frozen(points), _frozen(normals), area)


def sample_mesh_surface(model: mujoco.MjModel, mesh: int) -> Surface:
    """Samples a mesh asset of a compiled model."""
    return sample_surface(*mesh_triangles(model, mesh))


def mesh_triangles(
    model: mujoco.MjModel, mesh: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """Vertices [nvert, 3] and faces [nface, 3] of a mesh asset, in the asset's inertial frame."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return vertices, model.mesh_face[first : first + count].copy()


def sample_geom_surface(model: mujoco.MjModel, geom: int) -> Surface:
    """Samples the top of a height-field geom."""
    vertices, faces = hfield_triangles(model, int(model.geom_dataid[geom]))
    return sample_surface(vertices, faces)


def hfield_triangles(
    model: mujoco.MjModel, hfield: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices [nrow*ncol, 3] and faces of a height field's top, in its own frame, m."""
    nrow, ncol = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
    first = int(model.hfield_adr[hfield])
    x_half, y_half, top, _ = model.hfield_size[hfield]
    height = model.hfield_data[first : first + nrow * ncol] * top
    y, x = np.meshgrid(
        np.linspace(-y_half, y_half, nrow), np.linspace(-x_half, x_half, ncol), indexing="ij"
    )
    vertices = np.stack([x.ravel(), y.ravel(), height.astype(np.float64)], axis=1)
    index = np.arange(nrow * ncol).reshape(nrow, ncol)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
    return vertices, faces


def _frozen(array: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    copy = np.array(array, np.float64)
    copy.flags.writeable = False
    return copy
