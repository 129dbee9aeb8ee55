"""Which found object is which body, and which of a box's like orientations it has."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from orbisim_diffusion.symmetry import cube_rotations, unlike

Floats = npt.NDArray[np.float64]
_COLOUR, _SIZE, _STEP = 0.1, 0.15, 0.05
"""What counts as one unit of unlikeness: of a colour, of a size (relative), of a place (m)."""


def unlikeness(
    pos: Floats, size: Floats, colour: Floats, last: Floats, sizes: Floats, colours: Floats
) -> Floats:
    """[M, slots]: how little each found object is like each body.

    Args:
      pos, size, colour: [slots, 3] of what was found.
      last, sizes, colours: [M, 3] of bodies; `last` is NaN where it is not known.
    """
    apart = np.nan_to_num(np.linalg.norm(last[:, None] - pos[None], axis=-1)) / _STEP
    shade = np.abs(colours[:, None] - colour[None]).mean(-1) / _COLOUR
    ratio = np.abs(np.log(np.maximum(size[None], 1e-4) / np.maximum(sizes[:, None], 1e-4)))
    found: Floats = np.minimum(apart, 10.0) + shade + ratio.mean(-1) / _SIZE
    return found


def like_turns(size: Floats) -> Floats:
    """[K, 3, 3]: the rotations that take a box of these half sizes to itself."""
    half = torch.as_tensor(size)
    found: Floats = cube_rotations().double()[~unlike(half)].numpy()
    return found


def continuous(quat: Floats, before: Any) -> Floats:
    """The quaternion of the same rotation that is nearer to the one before."""
    return -quat if before is not None and float(quat @ np.nan_to_num(before)) < 0 else quat
