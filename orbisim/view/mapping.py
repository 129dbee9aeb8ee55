"""Where a 2D texture lies on a geom.

The formulas are those that MuJoCo's renderer follows (v runs downwards); the tests compare them
with its pictures.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Mapping:
    """How a material lays its 2D texture on a geom.

    Attributes:
      repeat: `texrepeat` of the material.
      uniform: its `texuniform`.
      size: the first two sizes of the geom; 0 where it is infinite.
    """

    repeat: tuple[float, float]
    uniform: bool
    size: tuple[float, float]

    def projected(self, position: Array) -> Array:
        """[n, 2] for points [n, 3] in the geom's frame: the texture falls along the z axis.

        Infinite planes, height fields and meshes without texture coordinates have it like this.
        """
        size = [s if s > 0 and not self.uniform else 1.0 for s in self.size]
        scale = 0.5 * np.array(self.repeat) / size
        uv: Array = position[:, :2] * scale * [1, -1] - 0.5
        return uv

    def stretched(self, uv: Array) -> Array:
        """[n, 2] for texture coordinates [n, 2] that cover the geom, or a face of it, once."""
        size = [s if s > 0 and self.uniform else 1.0 for s in self.size]
        return np.asarray(uv * self.repeat * size)


def face_uv(ends: Array) -> Array:
    """[n, 2] on a rectangular face, from positions [n, 2] in units of its half sizes."""
    return np.column_stack([0.5 + 0.5 * ends[:, 0], 0.5 - 0.5 * ends[:, 1]])
