"""Triangles of meshes and height fields as vertex buffers."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import MissingDependencyError
from orbisim.view.mapping import Mapping
from orbisim.view.three import Json, buffers

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh as the viewer draws it; `mapped` if it has texture coordinates."""

    geometry: Json
    mapped: bool


def mesh_of(
    model: mujoco.MjModel, mesh: int, mapping: Mapping | None, max_faces: int | None = None
) -> Mesh:
    """A mesh of the model with MuJoCo's normals and texture coordinates.

    Args:
      mapping: gives texture coordinates to a mesh that has none of its own.
      max_faces: simplify it if it has more triangles; normals and texture coordinates are lost.

    Raises:
      MissingDependencyError: simplification needs a package that is not installed.
    """
    vertex = _rows(model.mesh_vert, model.mesh_vertadr[mesh], model.mesh_vertnum[mesh])
    face_rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    face = model.mesh_face[face_rows]
    if max_faces is not None and len(face) > max_faces:
        return _simplified(vertex, face, max_faces)
    normals = _rows(model.mesh_normal, model.mesh_normaladr[mesh], model.mesh_normalnum[mesh])
    normal = _corner_normals(vertex[face], normals[model.mesh_facenormal[face_rows]])
    corners = [face.reshape(-1, 1), np.round(normal, 5).reshape(-1, 3)]
    has_uv = mapping is not None and model.mesh_texcoordadr[mesh] >= 0
    if has_uv:
        corners.append(model.mesh_facetexcoord[face_rows].reshape(-1, 1))
    distinct, index = np.unique(np.hstack(corners), axis=0, return_inverse=True)
    position = vertex[distinct[:, 0].astype(int)]
    uv = mapping.projected(position) if mapping else None
    if mapping is not None and has_uv:
        texcoord = _rows(
            model.mesh_texcoord, model.mesh_texcoordadr[mesh], model.mesh_texcoordnum[mesh]
        )
        uv = mapping.stretched(texcoord[distinct[:, 4].astype(int)])
    geometry = buffers(position, index.reshape(-1, 3), normal=distinct[:, 1:4], uv=uv)
    return Mesh(geometry, uv is not None)


def _rows(array: npt.NDArray[np.float32], start: int, count: int) -> Array:
    return np.asarray(array[start : start + count], np.float64)


_SHARP = 0.8
"""Cosine of the angle between a vertex normal and its face's from which on an edge is sharp."""


def _corner_normals(corner: Array, normal: Array) -> Array:
    """[m, 3, 3]: the model's normals, but the face's own where these are far from it.

    MuJoCo averages normals over all faces at a vertex and its renderer does the same to them.

    Args:
      corner: [m, 3, 3], positions of the corners of each triangle.
      normal: [m, 3, 3], the model's normals there.
    """
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    flat = np.divide(across, length, out=np.zeros_like(across), where=length > 0)[:, None]
    far = (flat * normal).sum(axis=-1, keepdims=True) < _SHARP
    return np.where(far & (length > 0)[:, None], flat, normal)


def _simplified(vertex: Array, face: npt.NDArray[np.int32], max_faces: int) -> Mesh:
    import trimesh

    mesh = trimesh.Trimesh(vertex, face, process=True)
    try:
        smaller = mesh.simplify_quadric_decimation(face_count=max_faces)
    except ImportError as error:
        raise MissingDependencyError("max_faces", "view", str(error)) from error
    return Mesh(buffers(smaller.vertices, smaller.faces, normal=smaller.vertex_normals), False)


def height_field(model: mujoco.MjModel, hfield: int, mapping: Mapping | None) -> Json:
    """A height field: its surface, and walls and a floor at its base."""
    rows, columns = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
    start = int(model.hfield_adr[hfield])
    x_size, y_size, top, base = (float(s) for s in model.hfield_size[hfield])
    x, y = np.meshgrid(np.linspace(-x_size, x_size, columns), np.linspace(-y_size, y_size, rows))
    z = top * np.asarray(model.hfield_data[start : start + rows * columns], np.float64)
    surface = np.stack([x.ravel(), y.ravel(), z], axis=1)
    number = np.arange(rows * columns).reshape(rows, columns)
    faces = _strips(number[:-1], number[1:])
    border = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    walls, wall_faces = _walls(surface[np.append(border, border[0])], -base, len(surface))
    floor = [[-x_size, -y_size, -base], [-x_size, y_size, -base]]
    floor += [[x_size, y_size, -base], [x_size, -y_size, -base]]
    position = np.concatenate([surface, walls, floor])
    floor_faces = np.array([[0, 1, 2], [0, 2, 3]]) + len(position) - 4
    uv = mapping.projected(position) if mapping else None
    return buffers(position, np.concatenate([faces, wall_faces, floor_faces]), uv=uv)


def _strips(lower: npt.NDArray[np.intp], upper: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Triangles between two sets of rows of vertex numbers, each [n, columns]."""
    a, b = lower[:, :-1], lower[:, 1:]
    c, d = upper[:, 1:], upper[:, :-1]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def _walls(rim: Array, bottom: float, first: int) -> tuple[Array, npt.NDArray[np.intp]]:
    """Vertices and triangles of the walls under a rim, none shared, so that edges stay sharp."""
    ends = np.stack([rim[:-1], rim[1:]], axis=1)
    feet = ends.copy()
    feet[..., 2] = bottom
    corners = np.concatenate([feet, ends[:, ::-1]], axis=1)
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    faces = (quad[None] + 4 * np.arange(len(corners))[:, None, None]).reshape(-1, 3) + first
    return corners.reshape(-1, 3), faces
