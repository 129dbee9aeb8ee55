"""Cameras and lights."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.bodies import Bodies
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.names import NameBook
from orbisim.scene.usd.pose import Pose, rotate
from orbisim.scene.usd.registry import Registry

_LIGHTS = {
    "DistantLight": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "SphereLight": mujoco.mjtLightType.mjLIGHT_POINT,
}
_OTHER_LIGHTS = ("DomeLight", "DomeLight_1", "RectLight", "DiskLight", "CylinderLight",
                 "GeometryLight", "PortalLight")  # fmt: skip
_FOCAL_LENGTH, _VERTICAL_APERTURE = 50.0, 15.2908  # UsdGeomCamera's fallbacks
_BRIGHTNESS = 0.7
"""Of a white light: MuJoCo's default for its own lights."""


def add_scenery(context: Context, registry: Registry, bodies: Bodies) -> None:
    """Adds what can be carried of cameras and lights."""
    cameras, lights = NameBook(), NameBook()
    for prim in context.prims.values():
        kind = prim.flat.type_name
        if kind == "Camera":
            _add_camera(context, registry, bodies, prim, cameras)
        elif kind in _LIGHTS:
            _add_light(context, registry, bodies, prim, lights)
        elif kind in _OTHER_LIGHTS:
            context.omit(prim.path, kind, "left out")
            prim.use(*prim.flat.attributes)


def _owner_and_pose(bodies: Bodies, prim: Prim) -> tuple[str | None, Pose]:
    owner = bodies.owner(prim.path)
    return owner.path if owner else None, bodies.pose_in(prim.path, owner)


def _add_camera(
    context: Context, registry: Registry, bodies: Bodies, prim: Prim, names: NameBook
) -> None:
    """Both look along -z with y up; only the field of view needs converting."""
    owner, pose = _owner_and_pose(bodies, prim)
    camera = registry.body(owner).add_camera(name=names(prim.flat.display_name or prim.flat.name))
    camera.pos, camera.quat = pose.pos, pose.quat
    if prim.token("projection", "perspective") == "orthographic":
        context.omit(prim.path, "an orthographic projection", "it is a perspective one")
    focal = prim.number("focalLength") or _FOCAL_LENGTH
    aperture = prim.number("verticalAperture") or _VERTICAL_APERTURE
    camera.fovy = math.degrees(2 * math.atan(abs(aperture) / (2 * abs(focal))))


def _add_light(
    context: Context, registry: Registry, bodies: Bodies, prim: Prim, names: NameBook
) -> None:
    """Colour and direction; USD's intensities are in physical units, MuJoCo's are not."""
    owner, pose = _owner_and_pose(bodies, prim)
    light = registry.body(owner).add_light(name=names(prim.flat.display_name or prim.flat.name))
    light.type = _LIGHTS[prim.flat.type_name]
    light.pos, light.dir = pose.pos, rotate(pose.quat, [0, 0, -1])
    colour = prim.numbers("inputs:color", 3)
    light.diffuse = np.clip(np.ones(3) if colour is None else colour, 0, 1) * _BRIGHTNESS
    context.omit(prim.path, "intensity of the light", "MuJoCo's default is used")
