"""Colliders, visual geometry and sites: what they are and whom they belong to."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.bodies import Bodies, Body
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.mass import MassApi, read_mass
from orbisim.scene.usd.meshes import collision_shapes, visual_shapes
from orbisim.scene.usd.pose import Pose
from orbisim.scene.usd.shapes import Shape, shapes_of
from orbisim.scene.usd.surfaces import Surface, read_surfaces

_WORLD = ""


@dataclasses.dataclass(frozen=True)
class Geometry:
    """A geometric prim.

    Attributes:
      prim: what it is made from.
      body: path of the body that it moves with; "" for the world.
      pose: its frame relative to the body's.
      shapes: its form; several for a mesh that is split.
      collides: whether it takes part in collisions and gives its body mass.
      surface: its physics material.
      mass: its own mass properties.
      density: kg/m^3 that holds for it, from whatever says so first.
    """

    prim: Prim
    body: str
    pose: Pose
    shapes: tuple[Shape, ...]
    collides: bool
    surface: Surface
    mass: MassApi
    density: float | None

    @property
    def path(self) -> str:
        """Path of the prim."""
        return self.prim.path


def read_geometry(context: Context, bodies: Bodies) -> list[Geometry]:
    """All geometry in the stage's order, without sites."""
    surfaces = read_surfaces(context)
    found = []
    for prim in context.prims.values():
        if is_site(prim):
            continue
        geometry = _read(context, bodies, surfaces, prim)
        if geometry is not None:
            found.append(geometry)
    _report_friction(context, found)
    return found


def is_site(prim: Prim) -> bool:
    """Whether a prim only marks a frame."""
    return prim.has("MjcSiteAPI") or prim.has("NewtonSiteAPI")


def _read(
    context: Context, bodies: Bodies, surfaces: Mapping[str, Surface], prim: Prim
) -> Geometry | None:
    if _is_deformable(context, prim):
        return None
    collides = prim.has("PhysicsCollisionAPI") and prim.flag("physics:collisionEnabled", True)
    shapes = _shapes(context, prim, collides)
    if shapes is None:
        if collides:
            what = prim.flat.type_name or "a prim without a type"
            context.omit(prim.path, f"PhysicsCollisionAPI on {what}", "it does not collide")
        return None
    owner = bodies.owner(prim.path)
    surface = surfaces.get(prim.flat.physics_material, Surface())
    return Geometry(
        prim=prim,
        body=owner.path if owner else _WORLD,
        pose=bodies.pose_in(prim.path, owner),
        shapes=tuple(shapes),
        collides=collides,
        surface=surface,
        mass=read_mass(context, prim) if collides else MassApi(),
        density=_density(context, prim, owner, surface) if collides else None,
    )


def _is_deformable(context: Context, prim: Prim) -> bool:
    """Whether a prim is part of a soft body, cloth or cable."""
    for step in context.lineage(prim.path):
        if any("Deformable" in schema for schema in step.flat.schemas):
            if step is prim or prim.flat.type_name in ("Mesh", "TetMesh", "BasisCurves"):
                context.omit(step.path, "a deformable body", "left out")
            return True
    return False


def _shapes(context: Context, prim: Prim, collides: bool) -> list[Shape] | None:
    if prim.flat.type_name == "Mesh":
        return collision_shapes(context, prim) if collides else visual_shapes(context, prim)
    if prim.flat.type_name == "Points" and not collides:
        return None  # particles; see `report`
    prim.use("physics:approximation")
    return shapes_of(context, prim)


def _density(context: Context, prim: Prim, owner: Body | None, surface: Surface) -> float | None:
    """The nearest density at or above a collider, up to its body; then its material's."""
    for step in context.lineage(prim.path):
        density = read_mass(context, step).density
        if density is not None:
            return density
        if owner is None or step.path == owner.path:
            break
    return surface.density


def _report_friction(context: Context, found: list[Geometry]) -> None:
    """What is said about contact that MuJoCo combines in its own way."""
    colliders = [geometry for geometry in found if geometry.collides]
    bare = [geometry for geometry in colliders if geometry.surface.friction is None]
    for item in bare:
        context.warn("no physics material is bound; MuJoCo's default friction holds", item.path)
    given = {geometry.surface.friction for geometry in colliders if geometry.surface.friction}
    if len(given) > 1 and not context.for_mujoco:
        context.warn(
            "colliders differ in friction: in a contact MuJoCo takes the larger coefficient, "
            "where UsdPhysics proposes the average"
        )
