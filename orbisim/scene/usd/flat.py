"""A USD stage in plain numbers, as the dumping process hands it over.

Composition, instancing, transforms, material bindings and collections are resolved; units, the up
axis and every attribute are as authored. Nothing here, and nothing that works on it, needs
OpenUSD.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int32]

Number = npt.NDArray[np.float32] | FloatArray
"""A number, vector or array of them; float32 where the file holds float32."""

Value = bool | int | str | tuple[str, ...] | Number | npt.NDArray[np.int64]
"""An attribute's value."""


@dataclasses.dataclass(frozen=True)
class FlatPrim:
    """One prim of the composed stage.

    Attributes:
      path: absolute; prims inside instances have the path of their instance.
      type_name: as authored, so that types whose schema is not installed are kept.
      schemas: applied API schemas as authored (`PhysicsDriveAPI:angular`).
      display_name: the authored display name, or "".
      matrix: [4, 4] local to world, stage units, for column vectors.
      local: [4, 4] local to parent (to the world, if it resets the stack).
      resets: whether the prim resets the transform stack.
      visible: whether it and all its ancestors are visible.
      purpose: computed purpose: default, render, proxy or guide.
      attributes: authored values; for animated attributes the first sample.
      relationships: forwarded targets, and the members of collision groups as `colliders`.
      animated: names of attributes that have more than one time sample.
      mesh: index into `FlatStage.meshes`, or -1.
      physics_material: path of the material bound for physics that has a physics schema, or "".
      look: index into `FlatStage.looks` of the bound material, or -1.
      omitted: names of attributes that are authored and whose values were too large or of a
        type without a counterpart here.
    """

    path: str
    type_name: str
    schemas: tuple[str, ...]
    display_name: str
    matrix: FloatArray
    local: FloatArray
    resets: bool
    visible: bool
    purpose: str
    attributes: Mapping[str, Value]
    relationships: Mapping[str, tuple[str, ...]]
    animated: tuple[str, ...] = ()
    mesh: int = -1
    physics_material: str = ""
    look: int = -1
    omitted: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The last component of the path."""
        return self.path.rpartition("/")[2]

    def has(self, schema: str) -> bool:
        """Whether an API schema is applied (`"PhysicsMassAPI"`)."""
        return schema in self.schemas


@dataclasses.dataclass(frozen=True)
class FlatMesh:
    """A triangle mesh; faces wind counter-clockwise seen from outside.

    Attributes:
      points: [n, 3] in the prim's own frame, stage units.
      triangles: [m, 3] indices into `points`.
      subsets: how many material subsets it is divided into.
    """

    points: Float32Array
    triangles: IntArray
    subsets: int = 0


@dataclasses.dataclass(frozen=True)
class Look:
    """What a `UsdPreviewSurface` says about a surface; colours are linear.

    Attributes:
      path: the material.
      rgba: diffuse colour and opacity.
      emission: mean of the emissive colour relative to the diffuse one, 0 to 1.
      metallic: 0 to 1, or -1 where it is not authored.
      roughness: 0 to 1, or -1 where it is not authored.
      textured: whether a texture drives the diffuse colour.
    """

    path: str
    rgba: tuple[float, float, float, float]
    emission: float
    metallic: float
    roughness: float
    textured: bool


@dataclasses.dataclass(frozen=True)
class Note:
    """Something that the dump already knows it leaves out (see `reading.Unsupported`)."""

    element: str
    feature: str
    consequence: str


@dataclasses.dataclass(frozen=True)
class FlatStage:
    """A composed stage.

    Attributes:
      prims: parents before children, siblings in the stage's order.
      meshes: geometry of the prims; equal meshes are held once.
      looks: appearance of the bound materials.
      name: name of the default prim, or "".
      meters_per_unit: as authored, or None.
      kilograms_per_unit: as authored, or None.
      up_axis: "Y" or "Z" as authored, or "".
      notes: what was left out while dumping.
    """

    prims: tuple[FlatPrim, ...]
    meshes: tuple[FlatMesh, ...] = ()
    looks: tuple[Look, ...] = ()
    name: str = ""
    meters_per_unit: float | None = None
    kilograms_per_unit: float | None = None
    up_axis: str = ""
    notes: tuple[Note, ...] = ()


def ancestors(path: str) -> Iterator[str]:
    """The path itself and the paths above it, nearest first, without the pseudo-root."""
    while path and path != "/":
        yield path
        path = path.rpartition("/")[0]


def is_within(path: str, root: str) -> bool:
    """Whether `path` is `root` or lies below it."""
    return path == root or path.startswith(root.rstrip("/") + "/")
