"""Objects of three.js, the library that meshcat draws with, in its JSON form.

meshcat's own Python classes have no normals, texture coordinates or capsules and number their
objects at random; these functions do the same job with all of these and give equal output for
equal input. Format: three.js "JSON Object/Scene format 4", arrays as MessagePack extensions (as
meshcat does it).
"""

from __future__ import annotations

import base64
import io
import uuid
from typing import Any

import numpy as np
import numpy.typing as npt
import umsgpack

Json = dict[str, Any]
Floats = npt.NDArray[np.floating[Any]]

_EXTENSIONS = {
    "uint8": (0x12, "Uint8Array"),
    "uint16": (0x14, "Uint16Array"),
    "uint32": (0x16, "Uint32Array"),
    "float32": (0x17, "Float32Array"),
}
"""Codes by which msgpack-lite, the browser's side, knows typed arrays."""

FRONT, DOUBLE = 0, 2
"""Which faces of a material are drawn."""

REPEAT = 1000
"""`THREE.RepeatWrapping`."""
_NAMESPACE = uuid.UUID("7a0f3c0e-3c5e-5f0b-9a52-0c4f6d2e9b11")


def typed(array: npt.NDArray[Any]) -> umsgpack.Ext:
    """A typed array of JavaScript, row-major."""
    return umsgpack.Ext(_EXTENSIONS[array.dtype.name][0], np.ascontiguousarray(array).tobytes())


def floats(array: npt.ArrayLike) -> umsgpack.Ext:
    """A `Float32Array`, row-major."""
    return typed(np.asarray(array, np.float32))


def _attribute(array: npt.NDArray[Any]) -> Json:
    size = 1 if array.ndim == 1 else array.shape[1]
    kind = _EXTENSIONS[array.dtype.name][1]
    return {"itemSize": size, "type": kind, "array": typed(array), "normalized": False}


def buffers(
    position: npt.ArrayLike,
    index: npt.ArrayLike | None = None,
    *,
    normal: npt.ArrayLike | None = None,
    uv: npt.ArrayLike | None = None,
    color: npt.ArrayLike | None = None,
) -> Json:
    """A geometry given by its vertices.

    Args:
      position: [n, 3]. index: [m, 3] triangles or [m, 2] lines; None if vertices follow in order.
      normal: [n, 3]; the browser averages face normals if None.
      uv: [n, 2]. color: [n, 3] or [n, 4] in [0, 1], times the material's colour.
    """
    given = {"position": position, "normal": normal, "uv": uv, "color": color}
    attributes = {
        name: _attribute(np.asarray(value, np.float32))
        for name, value in given.items()
        if value is not None
    }
    data: Json = {"attributes": attributes}
    if index is not None:
        small = len(np.asarray(position)) <= np.iinfo(np.uint16).max
        flat = np.asarray(index).ravel().astype(np.uint16 if small else np.uint32)
        data["index"] = _attribute(flat)
    return {"type": "BufferGeometry", "data": data}


def color_number(rgb: npt.ArrayLike) -> int:
    """A colour in [0, 1] as 0xRRGGBB."""
    red, green, blue = (round(255 * float(c)) for c in np.clip(np.asarray(rgb)[:3], 0, 1))
    return (red << 16) | (green << 8) | blue


def png_texture(pixels: npt.NDArray[np.uint8], wrap: int = REPEAT) -> Json:
    """A texture; v = 0 is the first row, as in MuJoCo.

    Args:
      pixels: [height, width], [height, width, 3] or [height, width, 4].
    """
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG", optimize=True)
    url = "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")
    return {"wrap": [wrap, wrap], "flipY": False, "anisotropy": 8, "image": {"url": url}}


def drawable(
    path: str,
    geometry: Json,
    material: Json,
    *,
    kind: str = "Mesh",
    matrix: npt.NDArray[np.float64] | None = None,
    **properties: Any,
) -> Json:
    """The command that puts an object at a path.

    Args:
      path: where in the viewer's tree.
      geometry: as from `buffers`, or a parametric one.
      material: a material; its entry `map` is a texture as from `png_texture`.
      kind: `Mesh` or `LineSegments`.
      matrix: [4, 4], from the geometry's frame to the path's.
      **properties: of the object; those in `userData` are set after meshcat's own.
    """
    ids = {
        role: str(uuid.uuid5(_NAMESPACE, f"{path} {role}"))
        for role in ("object", "geometry", "material", "texture", "image")
    }
    material = dict(material)
    scene: Json = {"metadata": {"version": 4.5, "type": "Object"}}
    texture = material.pop("map", None)
    if texture is not None:
        material["map"] = ids["texture"]
        image = texture["image"] | {"uuid": ids["image"]}
        scene["images"] = [image]
        scene["textures"] = [texture | {"uuid": ids["texture"], "image": ids["image"]}]
    scene["geometries"] = [geometry | {"uuid": ids["geometry"]}]
    scene["materials"] = [material | {"uuid": ids["material"]}]
    scene["object"] = {
        "uuid": ids["object"],
        "type": kind,
        "geometry": ids["geometry"],
        "material": ids["material"],
        "matrix": column_major(np.eye(4) if matrix is None else matrix),
        **properties,
    }
    return set_object(path, scene)


def light(path: str, kind: str, **properties: Any) -> Json:
    """The command that puts a light at a path."""
    identity = str(uuid.uuid5(_NAMESPACE, f"{path} object"))
    entry = {"uuid": identity, "type": kind, **properties}
    return set_object(path, {"metadata": {"version": 4.5, "type": "Object"}, "object": entry})


def column_major(matrix: npt.NDArray[np.float64]) -> list[float]:
    """The sixteen numbers of a transform in the order of three.js."""
    numbers: list[float] = np.asarray(matrix, np.float64).T.ravel().tolist()
    return numbers


# ---------------------------------------------------------------------------------------------
# meshcat's commands


def set_object(path: str, scene: Json) -> Json:
    """Puts an object at a path."""
    return {"type": "set_object", "path": path, "object": scene}


def set_transform(path: str, matrix: npt.NDArray[np.float64]) -> Json:
    """Places a path relative to its parent."""
    return {"type": "set_transform", "path": path, "matrix": column_major(matrix)}


def set_property(path: str, name: str, value: Any) -> Json:
    """Sets a property of the object at a path."""
    return {"type": "set_property", "path": path, "property": name, "value": value}


def packed(command: Json) -> bytes:
    """A command as it travels: its length (4 bytes, little-endian), then MessagePack."""
    body: bytes = umsgpack.packb(command)
    return len(body).to_bytes(4, "little") + body
