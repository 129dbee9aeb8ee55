"""Meshes and materials of the spec."""

from __future__ import annotations

import hashlib

import mujoco
import numpy as np

from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import Look
from orbisim.scene.usd.names import NameBook
from orbisim.scene.usd.solids import Solid

INERTIA = mujoco.mjtMeshInertia


class MeshAssets:
    """Adds meshes to a spec; equal ones once."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self._names = NameBook()
        self._known: dict[bytes, str] = {}

    def add(
        self, wanted: str, solid: Solid, inertia: mujoco.mjtMeshInertia, max_hull: int = -1
    ) -> str:
        """The name of the mesh asset with this geometry."""
        points = np.ascontiguousarray(solid.points, np.float32)
        triangles = np.ascontiguousarray(solid.triangles, np.int32)
        extra = f"{int(inertia)} {max_hull} {len(points)}".encode()
        key = hashlib.sha256(points.tobytes() + triangles.tobytes() + extra).digest()
        if key not in self._known:
            name = self._names(wanted)
            mesh = self._spec.add_mesh(name=name)
            mesh.uservert = points.ravel()
            mesh.userface = triangles.ravel()
            mesh.inertia = inertia
            mesh.maxhullvert = max_hull
            self._known[key] = name
        return self._known[key]


class MaterialAssets:
    """Adds materials to a spec."""

    def __init__(self, context: Context, spec: mujoco.MjSpec) -> None:
        self._context = context
        self._spec = spec
        self._names = NameBook()
        self._known: dict[str, str] = {}

    def add(self, look: Look) -> str:
        """The name of the material asset for a look."""
        if look.path not in self._known:
            name = self._names(look.path.rpartition("/")[2])
            material = self._spec.add_material(name=name)
            material.rgba = [*(_srgb(c) for c in look.rgba[:3]), min(max(look.rgba[3], 0), 1)]
            material.emission = look.emission
            if look.metallic >= 0:
                material.metallic = look.metallic
            if look.roughness >= 0:
                material.roughness = look.roughness
                material.shininess = min(max(1 - look.roughness, 0.0), 1.0)
            if look.textured:
                self._context.omit(look.path, "a texture of the diffuse colour", "shown white")
            self._known[look.path] = name
        return self._known[look.path]


def _srgb(linear: float) -> float:
    """A linear colour component as MuJoCo shows it (IEC 61966-2-1)."""
    linear = min(max(linear, 0.0), 1.0)
    if linear <= 0.0031308:
        return 12.92 * linear
    return float(1.055 * linear ** (1 / 2.4) - 0.055)
