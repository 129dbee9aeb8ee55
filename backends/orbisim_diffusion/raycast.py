"""Geometry buffers by differentiable ray casting, for any camera.

The nearest surfaces along each ray are put over each other with soft silhouettes, about a pixel
wide, so that pixels have gradients to poses, sizes and cameras also where an outline moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from orbisim_diffusion.shapes import MESH, PRIMITIVES, Meet, mesh
from orbisim_diffusion.solids import ABSENT, Lamps, Solids, View, constant, rays

LAYERS = 3
"""Surfaces along a ray that are put over each other; at an outline there are two."""
_EDGE = 0.35
"""Width of a soft outline, pixels: it falls from 0.95 to 0.05 within two."""
_SOFT = 7.0 * _EDGE
"""Pixels beyond an outline at which nothing is left of it: 1e-3."""
_NEAR = 1e-3
"""What is nearer is not seen, m; of the way to a light: what is nearer casts no shadow."""
_PAIRS = 2**25
"""Pairs of rays and geoms at once, where there is a choice: 128 MB for each number of a pair."""
_LIFT, _FAR = 2e-3, 10.0
"""Shadow rays start so far above the surface, m, and reach so far towards directional lights."""


class Buffers(NamedTuple):
    """What the rays see; 0 where they meet nothing.

    Attributes:
      depth: [B, H, W] along the line of sight's axis, m. normal: [B, 3, H, W] in the camera's
      frame. colour: [B, 3, H, W]. point: [B, 3, H, W] in the world frame, m.
      weight: [B, G, H, W] share of each geom in the pixel (instance).
    """

    depth: Tensor
    normal: Tensor
    colour: Tensor
    point: Tensor
    weight: Tensor


class Surfaces(NamedTuple):
    """What P rays of each view see, as `Buffers` but ray by ray.

    Attributes:
      depth: [B, P]. normal: [B, P, 3] in the camera's frame. colour: [B, P, 3].
      point: [B, P, 3]. weight: [B, G, P].
    """

    depth: Tensor
    normal: Tensor
    colour: Tensor
    point: Tensor
    weight: Tensor


def cast(
    solids: Solids,
    view: View,
    height: int,
    width: int,
    meshes: Mapping[int, Tensor] | None = None,
    primitives: Mapping[int, Meet] = PRIMITIVES,
    kinds: tuple[int, ...] | None = None,
) -> Buffers:
    """Casts a ray through the middle of each pixel.

    Args:
      solids: the geoms.
      view: the cameras.
      height, width: pixels.
      meshes: triangles [F, 3, 3] by the geom's place G, the same in every view.
      primitives: `orbisim_diffusion.shapes.PRIMITIVES`, or the same compiled.
      kinds: [G] the types of the geoms where they are the same in every view: then the host need
        not wait to learn them from the device.
    """
    ray = rays(view, height, width)  # [B, P, 3]
    seen = look(solids, view, ray, height, meshes, primitives, kinds)

    def image(values: Tensor) -> Tensor:
        """Of [B, P, C] to [B, C, H, W]."""
        return values.transpose(1, 2).unflatten(-1, (height, width))

    return Buffers(
        depth=image(seen.depth[..., None])[:, 0],
        normal=image(seen.normal),
        colour=image(seen.colour),
        point=image(seen.point),
        weight=seen.weight.unflatten(-1, (height, width)),
    )


def look(
    solids: Solids,
    view: View,
    ray: Tensor,
    height: int,
    meshes: Mapping[int, Tensor] | None = None,
    primitives: Mapping[int, Meet] = PRIMITIVES,
    kinds: tuple[int, ...] | None = None,
) -> Surfaces:
    """What some rays [B, P, 3] from the cameras see, in an image of `height` pixels."""
    eye, per_metre = view.pos[:, None].expand_as(ray), height * view.focal[:, None, 1:]
    if kinds is None and not torch.is_grad_enabled():
        meet = _meet_near(solids, eye, ray, meshes or {}, primitives, growth=_SOFT / per_metre)
    else:
        meet = _meet(solids, eye, ray, meshes or {}, primitives, kinds)
    t, inside, normal = meet  # [B, G, P (, 3)]
    pixel = t.abs() / per_metre  # m at that depth
    cover = torch.sigmoid(inside / (_EDGE * pixel.clamp_min(1e-6)))
    seen = (t > _NEAR) & (cover > 1e-3)
    weights, order = _layers(torch.where(seen, t, torch.inf), torch.where(seen, cover, 0.0))

    def blended(values: Tensor) -> Tensor:
        """Of [B, LAYERS, P, C] to [B, P, C]."""
        return (weights[..., None] * values).sum(1)

    index = order[..., None].expand(*order.shape, 3)
    depth = t.gather(1, order)[..., None]
    colour = solids.colour.gather(1, index.flatten(1, 2)).unflatten(1, order.shape[1:])
    return Surfaces(
        depth=blended(depth)[..., 0],
        normal=blended(normal.gather(1, index)) @ view.rot,
        colour=blended(colour),
        point=blended(view.pos[:, None, None] + depth * ray[:, None]),
        weight=torch.zeros_like(t).scatter_add(1, order, weights),
    )


def shade(
    buffers: Buffers,
    solids: Solids,
    view: View,
    lamps: Lamps,
    meshes: Mapping[int, Tensor] | None = None,
    primitives: Mapping[int, Meet] = PRIMITIVES,
    kinds: tuple[int, ...] | None = None,
) -> tuple[Tensor, Tensor]:
    """How much light falls on what is seen: [B, H, W] each, mean over the lights.

    Returns:
      The share of the lights that nothing is in the way of, and that share times the cosine of
      the angle of incidence.
    """
    height, width = buffers.depth.shape[-2:]
    normal = (view.rot @ buffers.normal.flatten(2)).transpose(1, 2)  # [B, P, 3], world frame
    point = buffers.point.flatten(2).transpose(1, 2)
    size = buffers.depth.flatten(1).clamp_min(0.1) / (height * view.focal[:, 1:])
    free, lit = torch.zeros_like(size), torch.zeros_like(size)
    # few pairs take less time than starting one more set of kernels; many would fill the memory
    at_once = max(1, _PAIRS // max(1, solids.kind.numel() * size.shape[1]))
    for rows in lamps.rows.split(at_once, dim=1):
        open_, ray = unblocked(
            *(point, normal, size, solids, Lamps(rows), meshes, primitives, kinds)
        )
        cosine = (ray * normal[:, None]).sum(-1) / ray.norm(dim=-1).clamp_min(1e-6)
        free, lit = free + open_.sum(1), lit + (open_ * cosine.clamp_min(0.0)).sum(1)
    count = max(1, lamps.rows.shape[1])
    there = buffers.weight.sum(1)
    return tuple(x.unflatten(-1, (height, width)) * there / count for x in (free, lit))


def unblocked(
    point: Tensor,
    normal: Tensor,
    size: Tensor,
    solids: Solids,
    lamps: Lamps,
    meshes: Mapping[int, Tensor] | None = None,
    primitives: Mapping[int, Meet] = PRIMITIVES,
    kinds: tuple[int, ...] | None = None,
) -> tuple[Tensor, Tensor]:
    """How much of L lights reaches points.

    Args:
      point, normal: [B, P, 3] of the surfaces, world frame, m. size: [B, P] of a pixel there, m.
      solids: what may be in the way. lamps: the lights.

    Returns:
      The share [B, L, P] that nothing is in the way of, and the way to the lights [B, L, P, 3], m.
    """
    eye, ray, size = _to_lamps(point, normal, size, lamps)
    among = solids, eye.flatten(1, 2), ray.flatten(1, 2), meshes or {}, primitives
    if kinds is None and not torch.is_grad_enabled():
        t, inside, _ = _meet_near(*among, slack=_SOFT * size, end=1.0, normals=False)
    else:
        t, inside, _ = _meet(*among, kinds, False)
    blocked = torch.where((t > _NEAR) & (t < 1.0), torch.sigmoid(inside / (_EDGE * size)), 0.0)
    passed = (1.0 - blocked).prod(1).unflatten(-1, ray.shape[1:3])
    return 1.0 - lamps.shadow[..., None] * (1.0 - passed), ray


def in_the_way(point: Tensor, normal: Tensor, size: Tensor, solids: Solids, lamps: Lamps) -> Tensor:
    """[B, G, L P]: geoms that come near the way from a point to a light; see `unblocked`."""
    eye, ray, size = _to_lamps(point, normal, size, lamps)
    return _near(solids, eye.flatten(1, 2), ray.flatten(1, 2), slack=_SOFT * size, end=1.0)


def _to_lamps(
    point: Tensor, normal: Tensor, size: Tensor, lamps: Lamps
) -> tuple[Tensor, Tensor, Tensor]:
    """Starts and ways [B, L, P, 3] from points to lights, and sizes [B, 1, L P] of pixels there."""
    start = (point + _LIFT * normal)[:, None]
    far = -_FAR * lamps.direction[:, :, None]
    ray = torch.where(lamps.directional[..., None, None] > 0, far, lamps.pos[:, :, None] - start)
    return start.expand_as(ray), ray, size[:, None].expand(ray.shape[:3]).flatten(1)[:, None]


def _layers(t: Tensor, cover: Tensor) -> tuple[Tensor, Tensor]:
    """Weights and places [B, LAYERS, P] of the nearest surfaces, front to back."""
    left, weights, places = torch.ones_like(t[:, 0]), [], []
    for _ in range(min(LAYERS, t.shape[1])):
        place = t.argmin(1, keepdim=True)
        share = cover.gather(1, place)[:, 0]
        weights.append(left * share)
        left = left * (1.0 - share)
        places.append(place[:, 0])
        t = t.scatter(1, place, torch.inf)
    return torch.stack(weights, 1), torch.stack(places, 1)


def _meet(
    solids: Solids,
    eye: Tensor,
    ray: Tensor,
    meshes: Mapping[int, Tensor],
    primitives: Mapping[int, Meet],
    kinds: tuple[int, ...] | None = None,
    normals: bool = True,
) -> tuple[Tensor, Tensor, Tensor]:
    """t, inside, and normals in the world frame, of every geom and ray (from `eye` [B, P, 3]).

    Where they are not wanted, normals are zeros.
    """
    if kinds is not None and MESH not in kinds:
        return _meet_alike(solids, eye, ray, primitives, kinds, normals)
    shape = (*solids.kind.shape, ray.shape[1])
    t, inside = ray.new_zeros(shape), ray.new_full(shape, -1.0)
    normal = ray.new_zeros((*(shape if normals else [1] * 3), 3))
    there = solids.entity != ABSENT
    for kind, meet in primitives.items():
        b, g = ((solids.kind == kind) & there).nonzero(as_tuple=True)
        if len(b):
            origin, local = _local(solids, eye, ray, b, g)
            found = meet(origin, local, solids.size[b, g])
            t, inside = t.index_put((b, g), found[0]), inside.index_put((b, g), found[1])
            if normals:
                turned = found[2] @ solids.rot[b, g].transpose(-1, -2)
                normal = normal.index_put((b, g), turned)
    for b, g in ((solids.kind == MESH) & there).nonzero().tolist():
        where = torch.tensor([b], device=ray.device), torch.tensor([g], device=ray.device)
        origin, local = _local(solids, eye, ray, *where)
        found = mesh(origin[0], local[0], meshes[g])
        t, inside = t.index_put(where, found[0][None]), inside.index_put(where, found[1][None])
        if normals:
            normal = normal.index_put(where, (found[2] @ solids.rot[b, g].T)[None])
    return t, inside, normal


def _meet_near(
    solids: Solids,
    eye: Tensor,
    ray: Tensor,
    meshes: Mapping[int, Tensor],
    primitives: Mapping[int, Meet],
    slack: Tensor | float = 0.0,
    growth: Tensor | float = 0.0,
    end: float = torch.inf,
    normals: bool = True,
) -> tuple[Tensor, Tensor, Tensor]:
    """`_meet` of the rays alone that come near a geom: most pass most geoms by far.

    Args:
      slack: [B, 1, P], m, by which a ray may pass the sphere about a geom. growth: [B, 1, 1], what
        is added for a length of the ray. end: of what lies beyond so many lengths nothing is said.
    """
    shape = (*solids.kind.shape, ray.shape[1])
    t, inside = ray.new_zeros(shape), ray.new_full(shape, -1.0)
    normal = ray.new_zeros((*(shape if normals else [1] * 3), 3))
    there, pos = solids.entity != ABSENT, solids.pos
    pairs = _near(solids, eye, ray, slack, growth, end).nonzero()
    kinds = solids.kind[pairs[:, 0], pairs[:, 1]]
    for kind, meet in primitives.items():
        index = pairs[kinds == kind].unbind(1)
        b, g, p = index
        if not len(b):
            continue
        rot = solids.rot[b, g]
        origin, local = (eye[b, p] - pos[b, g])[:, None] @ rot, ray[b, p][:, None] @ rot
        found = meet(origin, local, solids.size[b, g])
        t[index], inside[index] = found[0][:, 0], found[1][:, 0]
        if normals:
            normal[index] = (found[2] @ rot.mT)[:, 0]
    for b, g in ((solids.kind == MESH) & there).nonzero().tolist():
        rot = solids.rot[b, g]
        found = mesh((eye[b] - pos[b, g]) @ rot, ray[b] @ rot, meshes[g])
        t[b, g], inside[b, g] = found[:2]
        if normals:
            normal[b, g] = found[2] @ rot.T
    return t, inside, normal


def _near(
    solids: Solids,
    eye: Tensor,
    ray: Tensor,
    slack: Tensor | float = 0.0,
    growth: Tensor | float = 0.0,
    end: float = torch.inf,
) -> Tensor:
    """[B, G, P]: whether rays come near geoms, up to `end` of their length; see `_meet_near`."""
    square, pos = ray.square().sum(-1)[:, None], solids.pos
    dot = pos @ ray.mT - (eye * ray).sum(-1)[:, None]  # [B, G, P]
    apart = pos.square().sum(-1, keepdim=True) - 2.0 * pos @ eye.mT
    apart = apart + eye.square().sum(-1)[:, None]
    nearest = dot / square
    radius, wider = _sphere(solids)
    reach = radius[..., None] + wider[..., None] * (slack + growth * nearest.abs())
    along = reach * square.sqrt()
    near = (apart - nearest * dot < reach.square()) & (dot > -along) & (dot < end * square + along)
    return near & (solids.entity != ABSENT)[..., None]


def _sphere(solids: Solids) -> tuple[Tensor, Tensor]:
    """[B, G] radii, m, of spheres about primitives, infinite about planes; and how many m a ray
    passes them by for each m that `inside` falls: more than one of an ellipsoid's flat side."""
    x, y, _ = solids.size.unbind(-1)
    longest, shortest = solids.size.amax(-1), solids.size.amin(-1).clamp_min(1e-6)
    kinds = {2: x, 3: x + y, 4: longest, 5: x.hypot(y), 6: solids.size.norm(dim=-1)}
    radius = torch.full_like(x, torch.inf)
    for kind, value in kinds.items():
        radius = torch.where(solids.kind == kind, value, radius)
    return radius, torch.where(solids.kind == 4, longest / shortest, 1.0)


def _meet_alike(
    solids: Solids,
    eye: Tensor,
    ray: Tensor,
    primitives: Mapping[int, Meet],
    kinds: tuple[int, ...],
    normals: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """`_meet` of primitives whose types [G] are the same in every view."""
    count = len(ray)
    places = {kind: [g for g, k in enumerate(kinds) if k == kind] for kind in sorted(set(kinds))}
    parts: list[tuple[Tensor, ...]] = []
    for kind, chosen in places.items():
        index = constant(tuple(chosen), solids.kind)
        fields = solids.pos, solids.rot, solids.size
        pos, rot, size = (field[:, index].flatten(0, 1) for field in fields)

        def each(values: Tensor, number: int = len(chosen)) -> Tensor:
            return values[:, None].expand(-1, number, -1, -1).flatten(0, 1)

        found = primitives[kind]((each(eye) - pos[:, None]) @ rot, each(ray) @ rot, size)
        wanted = (*found[:2], found[2] @ rot.transpose(-1, -2)) if normals else found[:2]
        parts.append(tuple(v.unflatten(0, (count, -1)) for v in wanted))
    placed = [g for chosen in places.values() for g in chosen]
    order = constant(tuple(np.argsort(placed).tolist()), solids.kind)
    t, inside, *more = (torch.cat(field, 1)[:, order] for field in zip(*parts, strict=True))
    return t, inside, more[0] if more else ray.new_zeros(1, 1, 1, 3)


def _local(solids: Solids, eye: Tensor, ray: Tensor, b: Tensor, g: Tensor) -> tuple[Tensor, Tensor]:
    """Origins and directions [M, P, 3] in the frames of the geoms (b, g)."""
    rot = solids.rot[b, g]
    return (eye[b] - solids.pos[b, g][:, None]) @ rot, ray[b] @ rot
