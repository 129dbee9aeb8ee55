"""Joints in a first frame that no network has read; whether a frame shows them where they are."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt
import torch

from orbisim_diffusion.levenberg import losses
from orbisim_diffusion.refine import EXPLAINED, Refiner

Floats = npt.NDArray[np.float64]

_PLACES = 25
"""Positions that are tried over a joint's range: 15 degrees apart in a full turn. A fit bridges
half of that where a link is a few pixels wide."""
_ROUNDS = 2
"""A joint is tried with what is behind it anywhere, and once more with that where it belongs."""
_FEW = 5
"""Of the pixels so many stand for the others where it is asked whether joints are seen."""
_SPARSE = 3
"""Of the pixels, every third of every third row: links are wider."""


def start(refiner: Refiner, frame: npt.NDArray[np.uint8]) -> Floats:
    """Scalar joints [joints] near which a fit of a first frame may begin.

    The first keyframe, or `qpos0`, unless the frame is drawn better with joints elsewhere: each in
    turn is tried over its range, or a full turn, from the root on (coordinate descent on a grid).

    Args:
      refiner: of the scene and the camera. frame: [H, W, 3] of its size.
    """
    image = torch.as_tensor(frame).double() / 255.0
    grid = torch.arange(refiner.size**2).reshape(refiner.size, refiner.size)
    pixels = grid[::_SPARSE, ::_SPARSE].reshape(-1)
    wanted = image.reshape(-1, 3)[pixels].numpy()
    qpos = np.array(refiner.rest)
    for _ in range(_ROUNDS if len(refiner.scalar.qpos) > 1 else 1):
        for column in refiner.scalar.qpos:
            tried = np.concatenate([[qpos[column]], _places(refiner.model, int(column))])
            states = np.repeat(qpos[None], len(tried), 0)
            states[:, column] = tried
            drawn = refiner.eye.draw(states, pixels, refiner.shown([])).pixels.double().numpy()
            qpos = states[int(losses(drawn - wanted).sum((1, 2)).argmin())]
    found: Floats = qpos[refiner.scalar.qpos]
    return found


def _places(model: mujoco.MjModel, column: int) -> Floats:
    """Positions over the range of the joint of a column of `qpos`."""
    joint = int(np.flatnonzero(model.jnt_qposadr == column)[0])
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint]
        return np.linspace(low, high, _PLACES)
    hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
    reach = np.pi if hinge else float(model.stat.extent)
    return float(model.qpos0[column]) + np.linspace(-reach, reach, _PLACES)


def shows_joints(
    refiner: Refiner, frame: npt.NDArray[np.uint8], qpos: Floats, present: list[int]
) -> bool:
    """Whether a frame is drawn better with what the joints move than without.

    By more than half of what a perfect match would be, as for objects (`Pose.explained`). Where
    nothing that joints move is in the picture, it is not.

    Args:
      refiner: of the scene and the camera. frame: [H, W, 3]. qpos: [nq]. present: objects there.
    """
    pixels = torch.arange(refiner.size**2)[::_FEW]
    wanted = frame.reshape(-1, 3)[pixels] / 255.0
    geoms = refiner.shown(present)
    shown, blank = (
        refiner.eye.draw(qpos[None], pixels, some).pixels[0].double().numpy()
        for some in (geoms, refiner.unmoved(geoms))
    )
    gain = losses(blank - wanted).sum() - losses(shown - wanted).sum()
    return bool(gain > EXPLAINED * losses(blank - shown).sum())
