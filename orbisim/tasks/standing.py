"""Objects that stand on a floor: balls, boxes, cones, cylinders, lamps, chairs and others."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from orbisim.tasks.mechanisms.solids import Solid, box, cylinder, frustum

Floats = npt.NDArray[np.float64]
Draw = np.random.Generator
Shape = tuple[Solid, ...] | float
"""Convex solids above z = 0, or the radius of a ball that lies there, m."""


def _ball(rng: Draw, s: float) -> Shape:
    return 0.12 * s * rng.uniform(0.8, 1.2)


def _box(rng: Draw, s: float) -> Shape:
    x, y, z = s * rng.uniform(0.1, 0.26, 3)
    return (box((x, y, z), (0.0, 0.0, z / 2)),)


def _cone(rng: Draw, s: float) -> Shape:
    radius, height = s * rng.uniform(0.08, 0.15), s * rng.uniform(0.18, 0.34)
    return (frustum(radius, 0.08 * radius, height, (0.0, 0.0, height / 2)),)


def _cylinder(rng: Draw, s: float) -> Shape:
    radius, height = s * rng.uniform(0.05, 0.13), s * rng.uniform(0.12, 0.34)
    return (cylinder(radius, height, (0.0, 0.0, height / 2)),)


def _lamp(rng: Draw, s: float) -> Shape:
    """A foot, a stem and a shade."""
    foot, stem, height = s * rng.uniform(0.06, 0.1), s * rng.uniform(0.01, 0.02), s * 0.3
    height *= rng.uniform(0.8, 1.2)
    wide, narrow, tall = s * rng.uniform(0.09, 0.14), s * rng.uniform(0.04, 0.08), s * 0.12
    return (
        cylinder(foot, 0.03 * s, (0.0, 0.0, 0.015 * s)),
        cylinder(stem, height, (0.0, 0.0, height / 2)),
        frustum(wide, narrow, tall, (0.0, 0.0, height)),
    )


def _legs(half: tuple[float, float], side: float, height: float) -> tuple[Solid, ...]:
    places = [(a * half[0], b * half[1], height / 2) for a in (-1, 1) for b in (-1, 1)]
    return tuple(box((side, side, height), place) for place in places)


def _chair(rng: Draw, s: float) -> Shape:
    """A seat on four legs, and a back."""
    width, depth, height = s * rng.uniform(0.18, 0.24), s * rng.uniform(0.18, 0.24), s * 0.18
    height *= rng.uniform(0.8, 1.2)
    thick, side, back = 0.03 * s, 0.03 * s, s * rng.uniform(0.16, 0.24)
    half = (width / 2 - side / 2, depth / 2 - side / 2)
    return (
        *_legs(half, side, height),
        box((width, depth, thick), (0.0, 0.0, height + thick / 2)),
        box((thick, depth, back), (-width / 2 + thick / 2, 0.0, height + thick + back / 2)),
    )


def _stool(rng: Draw, s: float) -> Shape:
    """A round seat on four legs."""
    radius, height, side = s * rng.uniform(0.1, 0.15), s * rng.uniform(0.18, 0.28), 0.03 * s
    half = 0.6 * radius
    seat = cylinder(radius, 0.03 * s, (0.0, 0.0, height + 0.015 * s))
    return (*_legs((half, half), side, height), seat)


def _pyramid(rng: Draw, s: float) -> Shape:
    """Boxes on boxes, each smaller."""
    steps, width, rise = int(rng.integers(2, 5)), s * rng.uniform(0.22, 0.3), s * 0.07
    sides = [width * (1 - k / steps) for k in range(steps)]
    return tuple(box((w, w, rise), (0.0, 0.0, (k + 0.5) * rise)) for k, w in enumerate(sides))


PRIMITIVES: Mapping[str, Callable[[Draw, float], Shape]] = {
    "ball": _ball,
    "box": _box,
    "cone": _cone,
    "cylinder": _cylinder,
}
MESHES: Mapping[str, Callable[[Draw, float], Shape]] = {"lamp": _lamp, "chair": _chair}
UNSEEN: Mapping[str, Callable[[Draw, float], Shape]] = {"stool": _stool, "pyramid": _pyramid}
"""What no model is trained on."""


def add(
    spec: mujoco.MjSpec, body: str, name: str, shape: Shape, place: tuple[float, float], turn: float
) -> None:
    """Puts an object on the floor as geoms of a body.

    Args:
      body: the body's name. name: of the object. place: m. turn: about the vertical, rad.
    """
    owner, rgba = spec.body(body), [*_COLOURS[len(spec.body(body).geoms) % len(_COLOURS)], 1.0]
    if isinstance(shape, float):
        geom = owner.add_geom(name=name, pos=[*place, shape], rgba=rgba)
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [shape, 0.0, 0.0]
        return
    frame = Rotation.from_euler("z", turn)
    for number, solid in enumerate(shape):
        turned = frame * Rotation.from_euler("xyz", solid.rpy)
        quat = np.roll(turned.as_quat(), 1)
        pos = frame.apply(solid.pos) + [*place, 0.0]
        geom = owner.add_geom(name=f"{name}_{number}", pos=pos, quat=quat, rgba=rgba)
        if solid.kind == "box":
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, np.array(solid.size) / 2
        elif solid.kind == "cylinder":
            geom.type = mujoco.mjtGeom.mjGEOM_CYLINDER
            geom.size = [solid.size[0], solid.size[1] / 2, 0.0]
        else:
            made = solid.mesh(placed=False)
            mesh = spec.add_mesh(name=f"{name}_{number}")
            mesh.uservert, mesh.userface = made.vertices.ravel(), made.faces.ravel()
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, mesh.name


_COLOURS = ((0.8, 0.3, 0.2), (0.2, 0.6, 0.3), (0.8, 0.6, 0.2), (0.5, 0.3, 0.6))
