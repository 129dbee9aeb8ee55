"""TrajErr of videos: the states that StaInf reads off them, against the true ones."""

from __future__ import annotations

from typing import Any

import torch
from orbisim_world_model.losses import smooth
from orbisim_world_model.rotation import geodesic_distance
from torch import Tensor

from orbisim_diffusion.autoencoder import to_float
from orbisim_diffusion.inference import (
    Inferred,
    StateInference,
    Truth,
    errors,
    matched,
    robots,
    truth,
)
from orbisim_diffusion.loop import mixed
from orbisim_diffusion.model import Painter
from orbisim_diffusion.store import Store
from orbisim_diffusion.symmetry import rotation_error

_BATCH = 512  # images at once, so that memory does not grow with the number of videos


@torch.no_grad()  # type: ignore[untyped-decorator]
def read_off(painter: Painter, model: StateInference, videos: Tensor) -> Inferred:
    """What StaInf sees in videos [E, T, H, W, 3] uint8; fields [E * T, ...]."""
    parts = []
    for frames in videos.flatten(0, 1).split(_BATCH):
        with mixed(painter.device):
            latents = painter.autoencoder.encode(to_float(frames))
        parts.append(model(latents.float()))
    return Inferred(*map(torch.cat, zip(*parts, strict=True)))


def true_states(store: Store, horizon: int) -> Truth:
    """The states of the frames after the first, up to `horizon`; fields [E * T, ...]."""
    index = store.first[:, None] + torch.arange(1, horizon + 1, device=store.device)
    return truth(store, robots(store), index.flatten())


def trajectory_errors(found: Inferred, true: Truth, episodes: int, step: float) -> dict[str, Any]:
    """TrajErr = L_robot + L_object (paper, appendix B.1), SI units, mean over frames and episodes.

    Velocities are differences of positions of neighbouring frames. Rotations of boxes count up to
    the symmetries of their shape; the distance 1 - <p, q>^2 of quaternions is |P - Q|^2 / 8 of the
    matrices.

    Args:
      found, true: fields [E * T, ...]. episodes: E. step: time between frames, s.

    Returns:
      `TrajErr`, and the errors of `orbisim_diffusion.inference.errors`.
    """
    chosen, there = matched(found, true), true.there
    turned = torch.where(there, rotation_error(chosen.rot, true.rot, true.size), 0.0) / 8.0
    robot = smooth(found.hand_pos, true.hand_pos) + geodesic_distance(found.hand_rot, true.hand_rot)
    robot = robot + _moved(found.hand_pos, true.hand_pos, episodes, step)
    each = smooth(chosen.pos, true.pos) + turned
    each = each + _moved(chosen.pos, true.pos, episodes, step)
    objects = (each * there).sum(1) / there.sum(1).clamp_min(1)
    return {"TrajErr": round(float((robot + objects).mean()), 4), **errors(found, true)}


def _moved(found: Tensor, true: Tensor, episodes: int, step: float) -> Tensor:
    """Smooth-L1 [E * T, ...] of velocities; the first frame of an episode has the second's."""

    def velocity(pos: Tensor) -> Tensor:
        video = pos.unflatten(0, (episodes, -1))
        change = video.diff(dim=1) / step
        return torch.cat([change[:, :1], change], dim=1).flatten(0, 1)

    return smooth(velocity(found), velocity(true))
