"""What surrounds a scene: camera, lights, background and floor grid."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.view.kinematics import Kinematics
from orbisim.view.options import ViewOptions
from orbisim.view.parts import Part
from orbisim.view.shapes import disc
from orbisim.view.three import (
    DOUBLE,
    Json,
    color_number,
    column_major,
    drawable,
    light,
    png_texture,
    set_property,
    set_transform,
)

Array = npt.NDArray[np.float64]

CAMERA = "/Cameras/default/rotated/<object>"
_REPLACED = (
    "/Axes",
    "/Grid",
    "/Lights/AmbientLight",
    "/Lights/FillLight",
    "/Lights/PointLightNegativeX",
    "/Lights/PointLightPositiveX",
    "/Lights/SpotLight",
)
"""What meshcat puts around a scene, whatever its size; it can be shown again in the page."""


def stage(kinematics: Kinematics, parts: list[Part], options: ViewOptions) -> Iterator[Json]:
    """Commands that set camera, lights, background and, in a scene without a floor, a grid."""
    model = kinematics.model
    for path in _REPLACED:
        yield set_property(path, "visible", False)
    yield set_property("/Background", "top_color", list(options.theme.top))
    yield set_property("/Background", "bottom_color", list(options.theme.bottom))
    yield from camera(model, options)
    yield from _lights(model, options)
    if not any(part.kind == mujoco.mjtGeom.mjGEOM_PLANE for part in parts):
        yield from _grid(kinematics, options)


def camera_pose(model: mujoco.MjModel, options: ViewOptions) -> tuple[Array, Array]:
    """Where the first view is taken from and where it looks: MuJoCo's free camera.

    Returns:
      position [3], target [3], both in the world's frame.
    """
    free = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, free)
    azimuth = np.deg2rad(free.azimuth if options.azimuth is None else options.azimuth)
    elevation = np.deg2rad(free.elevation if options.elevation is None else options.elevation)
    forward = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    target = np.array(free.lookat)
    return target - float(free.distance) * forward, target


def camera(model: mujoco.MjModel, options: ViewOptions) -> Iterator[Json]:
    """Commands that set the first view.

    The camera stays in the root's frame: if the node that holds it is moved, as meshcat offers,
    the mouse turns it about one point while it looks at another. The page's own command `look_at`
    sets both. three.js's y axis points up.
    """
    position, target = camera_pose(model, options)
    extent = float(model.stat.extent)
    yield set_property(CAMERA, "position", _y_up(position))
    yield {"type": "look_at", "target": _y_up(target)}
    yield set_property(CAMERA, "fov", float(model.vis.global_.fovy))
    yield set_property(CAMERA, "near", 0.01 * extent)
    yield set_property(CAMERA, "far", 100.0 * extent)


def _y_up(point: Array) -> list[float]:
    return [float(point[0]), float(point[2]), -float(point[1])]


def _lights(model: mujoco.MjModel, options: ViewOptions) -> Iterator[Json]:
    """Light from everywhere, a main one, a weak one from the other side, one at the camera."""
    extent = float(model.stat.extent)
    center = np.eye(4)
    center[:3, 3] = model.stat.center
    white = color_number((1, 1, 1))
    no_shadow = {"castShadow": False}
    yield light("/Lights/ambient", "AmbientLight", color=white, intensity=0.48, userData=no_shadow)
    yield set_transform("/Lights/main", center)
    yield light(
        "/Lights/main",
        "DirectionalLight",
        color=white,
        intensity=0.4,
        matrix=_at(np.array([-0.45, -0.75, 1.6]) * 2 * extent),
        shadow=_shadow(extent),
        userData={"castShadow": options.shadows},
    )
    yield set_transform("/Lights/fill", center)
    yield light(
        "/Lights/fill",
        "DirectionalLight",
        color=white,
        intensity=0.1,
        matrix=_at(np.array([1.0, 0.8, 0.6]) * 2 * extent),
        userData=no_shadow,
    )
    yield light(
        f"{CAMERA}/light",
        "PointLight",
        color=white,
        intensity=0.15,
        distance=0.0,
        userData=no_shadow,
    )


def _at(position: Array) -> list[float]:
    matrix = np.eye(4)
    matrix[:3, 3] = position
    return column_major(matrix)


def _shadow(extent: float) -> Json:
    reach = 2.5 * extent
    box = {"left": -reach, "right": reach, "top": reach, "bottom": -reach}
    return {
        "bias": -0.0005,
        "normalBias": 0.002 * extent,
        "radius": 2,
        "mapSize": [2048, 2048],
        "camera": {
            "uuid": "shadow",
            "type": "OrthographicCamera",
            **box,
            "near": 0.1 * extent,
            "far": 10 * extent,
        },
    }


def _grid(kinematics: Kinematics, options: ViewOptions) -> Iterator[Json]:
    """A grid of lines at height 0, or under the scene if that reaches below."""
    extent = float(kinematics.model.stat.extent)
    cell = round_length(extent / 4)
    shape = disc(5 * extent, lambda position: position[:, :2] / cell)
    material = {
        "type": "MeshBasicMaterial",
        "color": color_number(options.theme.grid),
        "map": png_texture(_grid_pixels()),
        "side": DOUBLE,
        "transparent": True,
        "depthWrite": False,
        "vertexColors": True,
    }
    yield drawable(
        "/floor",
        shape.geometry,
        material,
        renderOrder=-1,
        userData={"castShadow": False, "receiveShadow": False},
    )
    floor = np.eye(4)
    floor[2, 3] = _lowest(kinematics)
    yield set_transform("/floor", floor)


def _lowest(kinematics: Kinematics) -> float:
    """Height of the lowest point of the geoms' bounding boxes, at most 0."""
    model, data = kinematics.model, kinematics.data
    lows = [0.0]
    for geom in np.flatnonzero(model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE):
        center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        upward = data.geom_xmat[geom, 6:9]
        lows.append(float(data.geom_xpos[geom, 2] + upward @ center - np.abs(upward) @ half))
    return min(lows)


def round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    fitting = [step for step in (1.0, 2.0, 5.0) if step * power <= length * (1 + 1e-9)]
    return float(fitting[-1] * power)


def _grid_pixels(size: int = 256, line: int = 2) -> npt.NDArray[np.uint8]:
    """[size, size, 4]: one cell, transparent but for a line along two sides."""
    pixels = np.full((size, size, 4), 255, np.uint8)
    pixels[line:, line:, 3] = 0
    return pixels
