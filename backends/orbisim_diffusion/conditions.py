"""What the denoiser sees of states and descriptors: spatial condition maps and object tokens."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim.scene.visible import ROBOT, STATIC
from orbisim_diffusion.config import Buffer, DenoiserConfig
from orbisim_diffusion.raycast import cast, shade
from orbisim_diffusion.shapes import PRIMITIVES, Meet
from orbisim_diffusion.solids import ABSENT, Lamps, Solids, View, constant, project

Meshes = Mapping[int, Tensor] | None

BUFFER_CHANNELS: dict[Buffer, int] = {
    "colour": 3,
    "normals": 3,
    "depth": 4,
    "instance": 3,
    "light": 2,
}
"""Channels of the geometry buffers, in their order. Depth: inverse depth 1, position 3."""
HEATMAP_CHANNELS = 8
"""Heat of robot and objects 2, their colours 3, their depth 1, position on the image 2."""
TOKEN_FEATURES = 27
"""Of each geom: type 8, size 3, colour 3, position 3, orientation 6, on the image 2, depth 1, kind
1."""
MOST_GEOMS = 32
"""That a single token of all has room for; the tasks' scenes have 15 to 18."""
STEPS, CONTROLS = 6, 16
"""Tokens of controls: as many steps as there are context frames, and room for so many actuators."""
_TYPES = 8  # of MuJoCo's geoms that are drawn: plane to mesh
_ORIGIN = (0.5, 0.0, 0.0)
"""Middle of the tasks' tables, m: positions are seen from there, in units of half a metre."""
_HEAT = 0.03
"""Standard deviation of a heat map's Gaussian, image heights (four pixels of 128)."""


def geometry_maps(
    solids: Solids,
    view: View,
    lamps: Lamps,
    height: int,
    width: int,
    meshes: Meshes = None,
    primitives: Mapping[int, Meet] = PRIMITIVES,
    kinds: tuple[int, ...] | None = None,
    left_out: tuple[Buffer, ...] = (),
) -> Tensor:
    """Spatial condition maps [B, M, H, W] of geometry buffers (configuration `default`).

    M is 15, less the channels of the buffers that are left out (`BUFFER_CHANNELS`).
    """
    buffers = cast(solids, view, height, width, meshes, primitives, kinds)
    entity = solids.entity
    owners = torch.stack([entity == STATIC, entity == ROBOT, entity > ROBOT], 1)
    shares = torch.einsum("bkg,bghw->bkhw", owners.to(buffers.weight.dtype), buffers.weight)
    there = buffers.weight.sum(1, keepdim=True)
    depth = buffers.depth[:, None] / there.clamp_min(1e-3)
    inverse = there / depth.clamp_min(0.1)
    origin = constant(_ORIGIN, buffers.point)[None, :, None, None]
    point = 2.0 * (buffers.point - origin * there)
    found: dict[Buffer, Tensor] = {
        "colour": 2.0 * buffers.colour - 1.0,
        "normals": buffers.normal,
        "depth": torch.cat([inverse - 1.0, point.clamp(-4, 4)], 1),
        "instance": shares,
    }
    if "light" not in left_out:  # its rays, to each light, are half of the work
        light = shade(buffers, solids, view, lamps, meshes, primitives, kinds)
        found["light"] = torch.stack(light, 1)
    return torch.cat([found[name] for name in BUFFER_CHANNELS if name not in left_out], dim=1)


def heatmaps(solids: Solids, view: View, height: int, width: int) -> Tensor:
    """Spatial condition maps [B, 8, H, W] of entities' centres (configuration `paper`).

    One Gaussian for each moving geom at its projected centre, and depth-like and colour maps in
    the same form.
    """
    place, depth = project(view, solids.pos)  # [B, G, 2], [B, G]
    x = (torch.arange(width, device=place.device) + 0.5 - width / 2) / height
    y = (torch.arange(height, device=place.device) + 0.5 - height / 2) / height
    apart = (place[..., 0, None, None] - x) ** 2 + (place[..., 1, None, None] - y[:, None]) ** 2
    moving = (solids.entity >= ROBOT) & (depth > 0)
    heat = torch.exp(-0.5 * apart / _HEAT**2) * moving[..., None, None]  # [B, G, H, W]
    objects = heat * (solids.entity > ROBOT)[..., None, None]
    robot = heat - objects
    total = heat.sum(1, keepdim=True)
    colour = torch.einsum("bghw,bgc->bchw", heat, solids.colour) / (total + 0.1)
    near = torch.einsum("bghw,bg->bhw", heat, 1.0 / depth.clamp_min(0.1))[:, None] / (total + 0.1)
    grid = torch.stack(torch.broadcast_tensors(x, y[:, None]))[None].expand(len(place), -1, -1, -1)
    return torch.cat(
        [robot.amax(1, keepdim=True), objects.amax(1, keepdim=True), colour, near, grid], dim=1
    )


def object_tokens(solids: Solids, view: View) -> tuple[Tensor, Tensor]:
    """Object-level tokens: features [B, G, 27] of each geom, and which are there [B, G]."""
    place, depth = project(view, solids.pos)
    kind = torch.nn.functional.one_hot(solids.kind.clamp(0, _TYPES - 1), _TYPES)
    origin = constant(_ORIGIN, solids.pos)
    parts = [
        kind.to(solids.pos.dtype),
        10.0 * solids.size.clamp(max=1.0),
        2.0 * solids.colour - 1.0,
        2.0 * (solids.pos - origin),
        solids.rot[..., :2].flatten(-2),
        2.0 * place.clamp(-2, 2),
        depth[..., None] - 1.0,
        solids.entity[..., None].clamp(-1, 1).to(solids.pos.dtype),
    ]
    there = solids.entity != ABSENT
    return torch.cat(parts, dim=-1) * there[..., None], there


def map_channels(config: DenoiserConfig) -> int:
    """M of the spatial condition maps; without any there is one map of zeros."""
    geometry = sum(n for name, n in BUFFER_CHANNELS.items() if name not in config.left_out)
    return {"geometry": geometry, "heatmaps": HEATMAP_CHANNELS, "none": 1}[config.maps]


def token_features(config: DenoiserConfig) -> int:
    """F of the tokens."""
    one = MOST_GEOMS * TOKEN_FEATURES
    return {"geoms": TOKEN_FEATURES, "one": one, "controls": CONTROLS + STEPS}[config.tokens]


def one_token(tokens: Tensor, there: Tensor) -> tuple[Tensor, Tensor]:
    """All geoms' features [B, G, 27] as a global state [B, 1, 32 * 27] (w/o Object-Centric).

    Raises:
      InputError: more geoms than there is room for.
    """
    if tokens.shape[1] > MOST_GEOMS:
        raise InputError(f"a token of all geoms is of at most {MOST_GEOMS}; got {tokens.shape[1]}")
    padded = tokens.new_zeros(len(tokens), MOST_GEOMS, TOKEN_FEATURES)
    padded[:, : tokens.shape[1]] = tokens
    return padded.flatten(1)[:, None], there.any(1, keepdim=True)


def control_tokens(controls: Tensor, index: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
    """Controls that led to a frame instead of its state (w/o Decoupling).

    Args:
      controls: [N, 16], those between a frame and the one before, zeros where there is none.
      index: [B] numbers of frames. first: [B] those of their episodes' first frames.

    Returns:
      [B, 6, 22] the last six steps' controls and which step it is, latest first, and which of them
      are there [B, 6]; the latest always is, since attention needs a token.
    """
    ago = torch.arange(STEPS, device=index.device)
    rows = index[:, None] - ago
    there = (rows > first[:, None]) | (ago == 0)
    which = torch.eye(STEPS, device=index.device).expand(len(index), -1, -1)
    tokens = torch.cat([controls[rows.clamp_min(0)], which], dim=-1)
    return tokens * there[..., None], there
