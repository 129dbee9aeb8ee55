"""Appearance of bound materials, as far as MuJoCo's materials can show it."""

from __future__ import annotations

from typing import Any

from pxr import UsdShade  # type: ignore[import-untyped,unused-ignore]

from orbisim.scene.usd.dump.xforms import TIME
from orbisim.scene.usd.flat import Look

_GREY = (0.18, 0.18, 0.18)  # UsdPreviewSurface's fallback
_COLOUR_INPUTS = ("diffuseColor", "diffuse_color_constant", "base_color")


class LookPool:
    """Collects looks by the path of their material."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self.looks: list[Look] = []

    def add(self, prim: Any) -> int:
        """Index of the look of the material bound to a prim, or -1."""
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not material:
            return -1
        path = str(material.GetPath())
        if path not in self._index:
            look = _look(material, path)
            self._index[path] = len(self.looks) if look else -1
            if look:
                self.looks.append(look)
        return self._index[path]


def _look(material: Any, path: str) -> Look | None:
    """What the surface shader of a material says, or None if it has none."""
    shader = material.ComputeSurfaceSource()[0] or material.ComputeSurfaceSource("mdl")[0]
    if not shader:
        return None
    colour, textured = _colour(shader)
    emissive, _ = _vector(shader, "emissiveColor")
    mean = sum(colour) / 3
    glow = sum(emissive) / 3 / mean if emissive and mean > 0 else 0.0
    opacity = _scalar(shader, "opacity", 1.0)
    return Look(
        path=path,
        rgba=(*colour, opacity),
        emission=min(max(glow, 0.0), 1.0),
        metallic=_scalar(shader, "metallic", -1.0),
        roughness=_scalar(shader, "roughness", -1.0),
        textured=textured,
    )


def _colour(shader: Any) -> tuple[tuple[float, float, float], bool]:
    for name in _COLOUR_INPUTS:
        values, textured = _vector(shader, name)
        if textured:
            return (1.0, 1.0, 1.0), True
        if values:
            return (values[0], values[1], values[2]), False
    return _GREY, False


def _vector(shader: Any, name: str) -> tuple[tuple[float, ...], bool]:
    """An input's three numbers, if it has them, and whether a texture drives it."""
    value, textured = _input(shader, name)
    try:
        numbers = tuple(float(item) for item in value)
    except TypeError:
        return (), textured
    return (numbers if len(numbers) == 3 else ()), textured


def _scalar(shader: Any, name: str, otherwise: float) -> float:
    value, _ = _input(shader, name)
    return float(value) if isinstance(value, float | int) else otherwise


def _input(shader: Any, name: str) -> tuple[Any, bool]:
    """The value that an input ends up with, and whether another shader computes it."""
    port = shader.GetInput(name)
    if not port:
        return None, False
    attributes = port.GetValueProducingAttributes()
    if not attributes:
        return None, False
    if UsdShade.Utils.GetType(attributes[0].GetName()) == UsdShade.AttributeType.Output:
        return None, True
    return attributes[0].Get(TIME), False
