"""Colours, materials and textures, as far as three.js's Phong material goes.

Not carried over: reflectance, cube and skybox textures (their mean colour is used), textures of
roles other than colour.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.view.mapping import Mapping
from orbisim.view.options import RGB, Look
from orbisim.view.parts import Appearance
from orbisim.view.three import DOUBLE, FRONT, Json, color_number, png_texture

_SHININESS = 128.0
"""OpenGL's exponent for MJCF's shininess of 1."""

_SPECULAR = 0.3
"""Highlights are weaker than OpenGL's: the viewer has more lights than most scenes."""

_RGB_ROLE = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


def phong(
    appearance: Appearance,
    *,
    side: int = FRONT,
    texture: Json | None = None,
    fades: bool = False,
    flat: bool = False,
) -> Json:
    """A material with the given appearance; `flat` shows facets."""
    rgb, alpha = appearance.rgba[:3], float(appearance.rgba[3])
    material: Json = {
        "type": "MeshPhongMaterial",
        "color": color_number(rgb),
        "emissive": color_number(appearance.emission * rgb),
        "specular": color_number(np.repeat(_SPECULAR * appearance.specular, 3)),
        "shininess": _SHININESS * appearance.shininess,
        "side": side,
        "opacity": alpha,
        "transparent": alpha < 1 or fades,
        "vertexColors": fades,
        "flatShading": flat,
    }
    return material if texture is None else material | {"map": texture}


def ghostly(look: Look) -> Json:
    """The material of a ghost; where it coincides with something solid, that is seen."""
    assert look.tint is not None
    return {
        "type": "MeshPhongMaterial",
        "color": color_number(look.tint),
        "emissive": color_number(0.25 * np.asarray(look.tint)),
        "specular": 0,
        "shininess": 0.0,
        "side": DOUBLE,
        "opacity": look.opacity,
        "transparent": True,
        "polygonOffset": True,
        "polygonOffsetFactor": 1.0,
        "polygonOffsetUnits": 4.0,
    }


def line_material(rgb: RGB | npt.NDArray[np.float64], opacity: float = 1.0) -> Json:
    """A material of lines; they are one pixel wide, which is all that WebGL offers."""
    return {
        "type": "LineBasicMaterial",
        "color": color_number(rgb),
        "opacity": opacity,
        "transparent": opacity < 1,
    }


def texture_mapping(
    model: mujoco.MjModel, appearance: Appearance, size: npt.NDArray[np.float64]
) -> Mapping | None:
    """How the 2D texture of a material lies on a geom of that size; None without such a texture."""
    if _texture(model, appearance, flat=True) < 0:
        return None
    repeat = model.mat_texrepeat[appearance.material]
    uniform = bool(model.mat_texuniform[appearance.material])
    return Mapping((float(repeat[0]), float(repeat[1])), uniform, (float(size[0]), float(size[1])))


def texture_of(model: mujoco.MjModel, appearance: Appearance) -> Json | None:
    """The 2D texture of a material."""
    texture = _texture(model, appearance, flat=True)
    return None if texture < 0 else png_texture(_pixels(model, texture))


def flattened(model: mujoco.MjModel, appearance: Appearance) -> Appearance:
    """The appearance with its texture replaced by the texture's mean colour."""
    texture = _texture(model, appearance, flat=False)
    if texture < 0:
        return appearance
    pixels = _pixels(model, texture)
    mean = pixels.reshape(len(pixels), pixels.shape[1], -1)[..., :3].mean(axis=(0, 1)) / 255
    rgba = appearance.rgba * [*np.broadcast_to(mean, 3), 1.0]
    return Appearance(rgba, -1, appearance.emission, appearance.specular, appearance.shininess)


def _texture(model: mujoco.MjModel, appearance: Appearance, flat: bool) -> int:
    """Number of a material's colour texture, only a 2D one if `flat`; -1 for none."""
    if appearance.material < 0:
        return -1
    texture = int(model.mat_texid[appearance.material, _RGB_ROLE])
    if flat and texture >= 0 and model.tex_type[texture] != mujoco.mjtTexture.mjTEXTURE_2D:
        return -1
    return texture


def _pixels(model: mujoco.MjModel, texture: int) -> npt.NDArray[np.uint8]:
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    channels, start = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
    data = np.asarray(model.tex_data[start : start + height * width * channels], np.uint8)
    image = data.reshape(height, width, channels)
    return image[..., 0] if channels == 1 else image
