"""Convex solids that parts of mechanisms are made of, and their mass."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial.transform import Rotation

Floats = npt.NDArray[np.float64]
Vector = tuple[float, float, float]
_SIDES = 24
"""Of a round solid's mesh."""


@dataclasses.dataclass(frozen=True)
class Solid:
    """A convex piece of a part, in the part's frame.

    Attributes:
      kind: a box (edges), a cylinder along z (radius, length), or a frustum along z (radius below,
        radius above, length), in m.
      size: as the kind has it.
      pos: of its centre, m.
      rpy: roll, pitch and yaw about fixed axes, rad, as URDF has them.
    """

    kind: Literal["box", "cylinder", "frustum"]
    size: tuple[float, ...]
    pos: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Floats:
        """[4, 4]."""
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_euler("xyz", self.rpy).as_matrix()
        matrix[:3, 3] = self.pos
        return matrix

    def mesh(self, placed: bool = True) -> trimesh.Trimesh:
        """A closed surface; in the part's frame, or in the solid's own."""
        if self.kind == "box":
            made = trimesh.creation.box(self.size)
        elif self.kind == "cylinder":
            made = trimesh.creation.cylinder(*self.size, sections=_SIDES)
        else:
            made = _frustum(*self.size)
        if placed:
            made.apply_transform(self.pose)
        return made


def box(size: Vector, pos: Vector = (0.0, 0.0, 0.0), rpy: Vector = (0.0, 0.0, 0.0)) -> Solid:
    """A box by its edges."""
    return Solid("box", size, pos, rpy)


def cylinder(
    radius: float, length: float, pos: Vector = (0.0, 0.0, 0.0), axis: Literal["x", "y", "z"] = "z"
) -> Solid:
    """A cylinder along an axis of the part."""
    turns = {"x": (0.0, np.pi / 2, 0.0), "y": (np.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}
    return Solid("cylinder", (radius, length), pos, turns[axis])


def frustum(below: float, above: float, length: float, pos: Vector = (0.0, 0.0, 0.0)) -> Solid:
    """A truncated cone along z."""
    return Solid("frustum", (below, above, length), pos)


def _frustum(below: float, above: float, length: float) -> trimesh.Trimesh:
    angle = np.arange(_SIDES) * 2 * np.pi / _SIDES
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)], axis=1)
    half = np.array([0.0, 0.0, length / 2])
    return trimesh.convex.convex_hull(np.concatenate([below * ring - half, above * ring + half]))


def surface(solids: Sequence[Solid]) -> trimesh.Trimesh:
    """The surfaces of all solids as one mesh, in the part's frame."""
    return trimesh.util.concatenate([solid.mesh() for solid in solids])


def mass_properties(solids: Sequence[Solid], density: float) -> tuple[float, Floats, Floats]:
    """Mass in kg, centre of mass [3] in m, and tensor [3, 3] about it in kg*m^2.

    Where solids overlap, the mass counts twice.

    Args:
      density: kg/m^3.
    """
    meshes = [solid.mesh() for solid in solids]
    for mesh in meshes:
        mesh.density = density
    masses = np.array([mesh.mass for mesh in meshes])
    centres = np.array([mesh.center_mass for mesh in meshes])
    com = masses @ centres / masses.sum()
    tensor = np.zeros((3, 3))
    for mass, centre, mesh in zip(masses, centres, meshes, strict=True):
        arm = centre - com
        tensor += mesh.moment_inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return float(masses.sum()), com, tensor
