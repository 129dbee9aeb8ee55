"""Mass properties that a document leaves out, or gives wrong, inferred from geometry."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import trimesh

from orbisim.scene.urdf.model import Array, Inertial, Shape

DENSITY = 1000.0
"""kg/m^3, MuJoCo's default for geoms."""

NEGLIGIBLE = Inertial(1e-6, np.zeros(3), 1e-8 * np.eye(3))
"""For a link that moves and has neither mass nor geometry: small beside any real part."""

MINIMUM = 1e-15
"""MuJoCo's mjMINVAL: masses and moments of moving bodies must be larger."""

ROUNDING = 1e-3
"""Relative violation of the triangle inequality that is put down to rounded numbers."""

MeshRule = Callable[[trimesh.Trimesh], Inertial | None]


def total(parts: Sequence[Inertial]) -> Inertial:
    """Several rigidly connected masses as one (parallel axis theorem)."""
    mass = sum(part.mass for part in parts)
    com = sum((part.mass * part.com for part in parts), np.zeros(3)) / mass
    tensor = sum(
        (part.tensor + part.mass * _offset(part.com - com) for part in parts), np.zeros((3, 3))
    )
    return Inertial(mass, com, tensor)


def _offset(r: Array) -> Array:
    tensor: Array = np.dot(r, r) * np.eye(3) - np.outer(r, r)
    return tensor


def problem_with(inertial: Inertial) -> str | None:
    """What is not physical about mass properties; None if nothing is.

    Without mass or without extent a link is a frame or a point, which is physical. Whether it may
    move is decided for the body that it is part of.
    """
    if inertial.mass < 0:
        return f"its mass is negative ({inertial.mass:g} kg)"
    if np.isnan(inertial.tensor).any():
        return "it declares a mass without moments of inertia"
    if inertial.mass == 0 or not inertial.tensor.any():
        return None
    moments = np.linalg.eigvalsh(inertial.tensor)
    if moments[0] <= 0:
        return f"its inertia is not positive definite (moments {_shown(moments)})"
    if moments[0] + moments[1] < moments[2]:
        return f"its moments of inertia {_shown(moments)} violate the triangle inequality"
    return None


def rounded(inertial: Inertial) -> Inertial | None:
    """Valid mass properties within rounding of the given ones; None if there are none.

    The largest moment of inertia is lowered to the sum of the two others.
    """
    if np.isnan(inertial.tensor).any():
        return None
    moments, axes = np.linalg.eigh(inertial.tensor)
    excess = moments[2] - moments[0] - moments[1]
    if inertial.mass <= MINIMUM or moments[0] <= 0 or excess > ROUNDING * moments[2]:
        return None
    moments[2] = (moments[0] + moments[1]) * (1 - 1e-12)
    return dataclasses.replace(inertial, tensor=(axes * moments) @ axes.T)


def _shown(moments: Iterable[float]) -> str:
    return ", ".join(f"{moment:.4g}" for moment in moments)


def of_shapes(
    shapes: Sequence[Shape], mesh: Callable[[Shape], trimesh.Trimesh], rule: MeshRule
) -> Inertial | None:
    """Mass properties of solid shapes at `DENSITY`; None if they have no volume.

    Overlaps count twice, as in MuJoCo.

    Args:
      mesh: loads the mesh of a shape, scaled.
      rule: mass properties of a mesh at density 1.
    """
    parts: list[Inertial] = []
    for shape in shapes:
        unit = rule(mesh(shape)) if shape.kind == "mesh" else _PRIMITIVES[shape.kind](*shape.size)
        if unit is not None and DENSITY * unit.mass > MINIMUM:
            parts.append(_placed(unit, shape))
    return total(parts) if parts else None


def _placed(unit: Inertial, shape: Shape) -> Inertial:
    """Mass properties at density 1 in a shape's frame, at `DENSITY` in the link's."""
    com = shape.rotation @ unit.com + shape.pos
    tensor = shape.rotation @ unit.tensor @ shape.rotation.T
    return Inertial(DENSITY * unit.mass, com, DENSITY * tensor)


def with_mass(mass: float, com: Array, geometry: Inertial | None) -> Inertial:
    """A given mass with the tensor of a geometry, or else of a solid sphere at `DENSITY`."""
    if geometry is not None:
        return Inertial(mass, com, geometry.tensor * (mass / geometry.mass))
    radius = (3 * mass / (4 * np.pi * DENSITY)) ** (1 / 3)
    return Inertial(mass, com, 0.4 * mass * radius**2 * np.eye(3))


# ---- at density 1, in the shape's own frame ----------------------------------------------------


def _box(x: float, y: float, z: float) -> Inertial:
    volume = x * y * z
    moments = volume / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    return Inertial(volume, np.zeros(3), np.diag(moments))


def _sphere(radius: float) -> Inertial:
    volume = 4 / 3 * np.pi * radius**3
    tensor = trimesh.inertia.sphere_inertia(volume, radius)
    return Inertial(volume, np.zeros(3), tensor)


def _cylinder(radius: float, length: float) -> Inertial:
    volume = np.pi * radius**2 * length
    tensor = trimesh.inertia.cylinder_inertia(volume, radius, length)
    return Inertial(volume, np.zeros(3), tensor)


def _capsule(radius: float, length: float) -> Inertial:
    """A cylinder and two half spheres; a half sphere's centre is 3/8 of the radius off its base."""
    caps = _sphere(radius)
    shift = length / 2 + 3 / 8 * radius
    half = caps.tensor[0, 0] / caps.mass - (3 / 8 * radius) ** 2  # about its own centre, per mass
    side = caps.mass * (half + shift**2)
    middle = _cylinder(radius, length)
    ends = np.diag([side, side, caps.tensor[2, 2]])
    return Inertial(middle.mass + caps.mass, np.zeros(3), middle.tensor + ends)


_PRIMITIVES: Mapping[str, Callable[..., Inertial]] = {
    "box": _box,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "capsule": _capsule,
}


def legacy(mesh: trimesh.Trimesh) -> Inertial | None:
    """MuJoCo's default: pyramids between triangles and an inner point, every volume positive."""
    return _solid(mesh, np.abs)


def exact(mesh: trimesh.Trimesh) -> Inertial | None:
    """Signed pyramids; right for a closed mesh, None for one that is open."""
    merged = mesh.copy()
    merged.merge_vertices()  # STL repeats them for every triangle
    if not merged.is_watertight:
        return None
    return _solid(merged, np.negative if merged.volume < 0 else np.positive)


def exact_or_convex(mesh: trimesh.Trimesh) -> Inertial | None:
    """The mesh where it is closed, else its convex hull."""
    return exact(mesh) or convex(mesh)


def convex(mesh: trimesh.Trimesh) -> Inertial | None:
    """The convex hull; None if the points lie in a plane."""
    try:
        return exact(mesh.convex_hull)
    except Exception:  # Qhull's errors: there is no hull
        return None


MESH_RULES: Mapping[str, MeshRule] = {"legacy": legacy, "exact": exact_or_convex, "convex": convex}


def _solid(mesh: trimesh.Trimesh, sign: Callable[[Array], Array]) -> Inertial | None:
    """Mass properties at density 1, as MuJoCo sums them up.

    The centre of mass comes from pyramids over the centroid of the surface, mass and tensor from
    pyramids over that centre. For signed volumes the apex makes no difference.

    Args:
      sign: turns signed volumes of the pyramids into those that count.
    """
    triangles = np.asarray(mesh.triangles, np.float64)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1)
    if not area.sum() > 0:
        return None
    centroid = area @ triangles.mean(axis=1) / area.sum()
    mass, first, _ = _pyramids(triangles - centroid, cross, sign)
    if not mass > 0:
        return None
    com = centroid + first / mass
    mass, _, second = _pyramids(triangles - com, cross, sign)
    return Inertial(mass, com, np.trace(second) * np.eye(3) - second)


def _pyramids(
    corners: Array, cross: Array, sign: Callable[[Array], Array]
) -> tuple[float, Array, Array]:
    """Volume, first moment [3] and second moment [3, 3] of pyramids with their apex at zero.

    With s the sum of a triangle's corners and S the sum of their outer products, the pyramid over
    it has first moment V s / 4 and second moment V (S + s s') / 20.

    Args:
      corners: [n, 3, 3] corners of the triangles. cross: [n, 3] twice their area vectors.
    """
    volume = sign(np.einsum("ni,ni->n", corners[:, 0], cross) / 6)
    sums = corners.sum(axis=1)
    second = np.einsum("n,nki,nkj->ij", volume, corners, corners)
    second = second + np.einsum("n,ni,nj->ij", volume, sums, sums)
    return float(volume.sum()), volume @ sums / 4, second / 20
