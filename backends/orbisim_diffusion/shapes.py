"""Where rays meet primitives and meshes, each in the geom's own frame.

Every function takes origins and directions [M, P, 3] and sizes [M, 3], and returns

- t [M, P]: where the ray enters, in lengths of its direction; for a ray that misses, where it
  comes nearest;
- inside [M, P]: by how much it hits: a length in m that is positive for rays that hit and goes to
  0, and below, towards and beyond the silhouette;
- normal [M, P, 3]: of the surface at t.

All three are differentiable in all arguments, except where a ray meets an edge.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

Hit = tuple[Tensor, Tensor, Tensor]
_TINY = 1e-9  # keeps rays that never meet a surface from dividing by zero
_ENDLESS = 1e3
"""Half size, m, of a plane that MuJoCo calls infinite (its renderer ends somewhere, too)."""


def plane(origin: Tensor, ray: Tensor, size: Tensor) -> Hit:
    """The rectangle z = 0 with half sizes x and y; 0 for endless. Seen from above only."""
    down = torch.where(ray[..., 2].abs() < _TINY, -_TINY, ray[..., 2])
    t = -origin[..., 2] / down
    point = origin + t[..., None] * ray
    half = torch.where(size[:, None, :2] > 0, size[:, None, :2], _ENDLESS)
    inside = (half - point[..., :2].abs()).amin(-1)
    faces = (down < 0) & (t > 0)
    normal = torch.zeros_like(ray)
    normal[..., 2] = 1.0
    return t, torch.where(faces, inside, -_ENDLESS), normal


def sphere(origin: Tensor, ray: Tensor, size: Tensor) -> Hit:
    """Of radius size[0]."""
    return _ball(origin, ray, size[:, :1])


def ellipsoid(origin: Tensor, ray: Tensor, size: Tensor) -> Hit:
    """With semi-axes size."""
    scale = size[:, None]
    t, inside, normal = _ball(origin / scale, ray / scale, torch.ones_like(size[:, :1]))
    normal = normal / scale
    return t, inside * size.amin(-1, keepdim=True), normal / _length(normal)


def capsule(origin: Tensor, ray: Tensor, size: Tensor) -> Hit:
    """Around the z axis from -size[1] to size[1], of radius size[0]."""
    radius, half = size[:, :1], size[:, 1:2]
    aa = ray[..., :2].square().sum(-1).clamp_min(_TINY)
    ab = (ray[..., :2] * origin[..., :2]).sum(-1)
    t_axis = -ab / aa  # nearest to the axis
    along = origin[..., 2] + t_axis * ray[..., 2]
    disc = ab.square() - aa * (origin[..., :2].square().sum(-1) - radius.square())
    t_side = (-ab - disc.clamp_min(_TINY).sqrt()) / aa
    z = origin[..., 2] + t_side * ray[..., 2]
    side = (disc > 0) & (z.abs() <= half)
    end = torch.where(disc > 0, z, along).clamp(-half, half)
    centre = torch.stack([torch.zeros_like(end), torch.zeros_like(end), end], dim=-1)
    t_cap, in_cap, _ = _ball(origin - centre, ray, radius)
    t = torch.where(side, t_side, t_cap)
    nearest = (origin[..., :2] + t_axis[..., None] * ray[..., :2]).square().sum(-1)
    in_side = radius - nearest.add(_TINY).sqrt()
    inside = torch.where(along.abs() <= half, in_side, in_cap)
    inside = torch.where(side, inside.clamp_min(0.0), inside)
    point = origin + t[..., None] * ray
    spine = torch.stack(
        [torch.zeros_like(t), torch.zeros_like(t), point[..., 2].clamp(-half, half)], dim=-1
    )
    normal = point - spine
    return t, inside, normal / _length(normal)


def cylinder(origin: Tensor, ray: Tensor, size: Tensor) -> Hit:
    """Around the z axis from -size[1] to size[1], of radius size[0]."""
    radius, half = size[:, :1], size[:, 1:2]
    aa = ray[..., :2].square().sum(-1).clamp_min(_TINY)
    ab = (ray[..., :2] * origin[..., :2]).sum(-1)
    disc = ab.square() - aa * (origin[..., :2].square().sum(-1) - radius.square())
    root = disc.sign() * disc.abs().add(_TINY).sqrt()
    enter, leave = (-ab - root) / aa, (-ab + root) / aa
    low, high = _slab(origin[..., 2], ray[..., 2], half)
    t, chord = _between(torch.maximum(enter, low), torch.minimum(leave, high))
    point = origin + t[..., None] * ray
    cap = low > enter
    sign = -ray[..., 2].sign()
    upright = torch.stack([torch.zeros_like(t), torch.zeros_like(t), sign], dim=-1)
    round_ = torch.stack([point[..., 0], point[..., 1], torch.zeros_like(t)], dim=-1)
    normal = torch.where(cap[..., None], upright, round_ / _length(round_))
    return t, chord * _length(ray)[..., 0], normal


def box(origin: Tensor, ray: Tensor, size: Tensor) -> Hit:
    """With half sizes size."""
    low, high = _slab(origin, ray, size[:, None])
    enter, axis = low.max(-1)
    t, chord = _between(enter, high.amin(-1))
    axes = torch.nn.functional.one_hot(axis, 3).to(ray.dtype)
    return t, chord * _length(ray)[..., 0], -ray.sign() * axes


Meet = Callable[[Tensor, Tensor, Tensor], Hit]

PRIMITIVES: Mapping[int, Meet] = {
    0: plane,
    2: sphere,
    3: capsule,
    4: ellipsoid,
    5: cylinder,
    6: box,
}
"""By MuJoCo's number of the geom's type (`mujoco.mjtGeom`)."""
MESH = 7
"""MuJoCo's number of meshes."""


@functools.cache
def compiled_primitives() -> Mapping[int, Meet]:
    """`PRIMITIVES`, each as one kernel for any number of geoms and rays (tens of seconds, once)."""
    return {kind: torch.compile(meet, dynamic=True) for kind, meet in PRIMITIVES.items()}


def mesh(origin: Tensor, ray: Tensor, triangles: Tensor) -> Hit:
    """Triangles [F, 3, 3] in the geom's frame, one after another (Moeller and Trumbore).

    Args:
      origin, ray: [P, 3].
      triangles: corners.
    """
    best = torch.full(ray.shape[:1], torch.inf, device=ray.device, dtype=ray.dtype)
    which = torch.zeros_like(best, dtype=torch.long)
    step = max(1, 2**22 // max(1, len(ray)))  # pairs of rays and triangles at a time: 64 MB
    with torch.no_grad():
        for first in range(0, len(triangles), step):
            t = _triangle(origin[:, None], ray[:, None], triangles[None, first : first + step])
            nearest, index = t.min(1)
            closer = nearest < best
            best = torch.where(closer, nearest, best)
            which = torch.where(closer, index + first, which)
    chosen = triangles[which]
    normal = torch.linalg.cross(chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0])
    normal = normal / _length(normal)
    away = (normal * ray).sum(-1, keepdim=True)
    t = (normal * (chosen[:, 0] - origin)).sum(-1) / torch.where(away.abs() < _TINY, _TINY, away)[
        :, 0
    ]
    hit = torch.isfinite(best)
    inside = torch.where(hit, 1.0, -1.0).to(ray.dtype)  # a mesh's silhouette has no gradient
    return torch.where(hit, t, 0.0), inside, torch.where(away < 0, normal, -normal)


def _triangle(origin: Tensor, ray: Tensor, corners: Tensor) -> Tensor:
    """Where rays [P, 1, 3] meet triangles [1, F, 3, 3]: [P, F], infinite for a miss."""
    a, ab, ac = (
        corners[..., 0, :],
        corners[..., 1, :] - corners[..., 0, :],
        corners[..., 2, :] - corners[..., 0, :],
    )
    ray, ac, ab = torch.broadcast_tensors(ray, ac, ab)
    h = torch.linalg.cross(ray, ac)
    det = (ab * h).sum(-1)
    inverse = 1.0 / torch.where(det.abs() < 1e-12, torch.inf, det)
    s = origin - a
    u = (s * h).sum(-1) * inverse
    q = torch.linalg.cross(s, ab)
    v = (ray * q).sum(-1) * inverse
    t = (ac * q).sum(-1) * inverse
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & (inverse != 0)
    return torch.where(hit, t, torch.inf)


def _ball(origin: Tensor, ray: Tensor, radius: Tensor) -> Hit:
    aa = ray.square().sum(-1)
    ab = (origin * ray).sum(-1)
    t_near = -ab / aa
    apart = (origin + t_near[..., None] * ray).square().sum(-1)
    disc = (radius.square() - apart).clamp_min(_TINY) / aa
    t = t_near - disc.sqrt()
    normal = origin + t[..., None] * ray
    return t, radius - apart.add(_TINY**2).sqrt(), normal / _length(normal)


def _slab(origin: Tensor, ray: Tensor, half: Tensor) -> tuple[Tensor, Tensor]:
    """Where rays enter and leave -half to half."""
    safe = torch.where(ray.abs() < _TINY, _TINY, ray)
    centre, reach = -origin / safe, half / safe.abs()
    return centre - reach, centre + reach


def _between(enter: Tensor, leave: Tensor) -> tuple[Tensor, Tensor]:
    """Where a ray meets what it enters and leaves there, and for how long it is inside."""
    chord = leave - enter
    return torch.where(chord > 0, enter, 0.5 * (enter + leave)), chord


def _length(vector: Tensor) -> Tensor:
    return vector.square().sum(-1, keepdim=True).clamp_min(_TINY**2).sqrt()
