"""Signed distances of points from what stands still in a scene, with normals, in torch.

Boxes, balls, cylinders and capsules are exact; meshes count as their convex
hulls, as in MuJoCo, and of these the distance outside is to the farthest face's plane, which is
less than the true one beyond edges and corners. All still geoms of a scene are one set of solids:
one object, as the paper has it (appendix B.4).
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.errors import UnsupportedSceneError

Floats = npt.NDArray[np.float64]
_FAR = 1e3
"""m: where solids are that are none (padding), and what a face's plane is lowered by."""
_TINY = 1e-9
"""Lengths below it have no direction."""
_BOX, _CYLINDER, _BALL = 0.0, 1.0, 2.0
"""Kinds of rounded solids."""


class Solids(NamedTuple):
    """What stands still, in the world's frame; B scenes.

    Attributes:
      centre: [B, R, 3]. turn: [B, R, 3, 3], columns are the solid's axes. size: [B, R, 3] half
        sides of a box; radius, half length of a cylinder; radius of a ball, m. round: [B, R] radius
        about a cylinder's axis if it is a capsule, m. kind: [B, R].
      planes: [B, P, F, 4] outward normals and offsets of convex solids' faces.
      sliding: [B] friction of the cloth on what is there.
    """

    centre: Tensor
    turn: Tensor
    size: Tensor
    round: Tensor
    kind: Tensor
    planes: Tensor
    sliding: Tensor

    def at(self, index: Tensor | int | slice) -> Solids:
        """Some of the scenes."""
        return Solids(*(field[index] for field in self))

    def to(self, device: torch.device | str) -> Solids:
        """On a device."""
        return Solids(*(field.to(device) for field in self))

    def expand(self, count: int) -> Solids:
        """One scene's, for so many worlds."""
        return Solids(*(field.expand(count, *field.shape[1:]) for field in self))


class Near(NamedTuple):
    """The nearest solid of each point.

    Attributes:
      distance: [B, N], negative inside, m. normal: [B, N, 3], outwards, where distance grows.
    """

    distance: Tensor
    normal: Tensor


def read_solids(model: mujoco.MjModel, source: str = "scene") -> Solids:
    """What a scene's flex can touch and does not move; one scene.

    Raises:
      UnsupportedSceneError: a geom's shape has no distance here.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    still = model.body_weldid[model.geom_bodyid] == 0
    touch = (model.geom_contype & model.flex_conaffinity[0]) | (
        model.geom_conaffinity & model.flex_contype[0]
    )
    rows: list[tuple[Floats, Floats, Floats, float, float]] = []
    faces: list[Floats] = []
    for geom in np.flatnonzero(still & (touch != 0)):
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        place = data.geom_xpos[geom].copy()
        turn, size = data.geom_xmat[geom].reshape(3, 3).copy(), model.geom_size[geom].copy()
        if kind == mujoco.mjtGeom.mjGEOM_PLANE:
            normal = turn[:, 2]
            faces.append(np.array([[*normal, normal @ place]]))
        elif kind == mujoco.mjtGeom.mjGEOM_MESH:
            faces.append(_hull(model, int(model.geom_dataid[geom]), place, turn))
        elif kind == mujoco.mjtGeom.mjGEOM_BOX:
            rows.append((place, turn, size, 0.0, _BOX))
        elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            rows.append((place, turn, size, 0.0, _BALL))
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            rows.append((place, turn, size, 0.0, _CYLINDER))
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            rows.append((place, turn, np.array([0.0, size[1], 0.0]), float(size[0]), _CYLINDER))
        else:
            name = model.geom(int(geom)).name or int(geom)
            raise UnsupportedSceneError(
                source,
                f"a learned cloth knows no distance from a geom of type {kind.name[7:].lower()}",
                element=f"geom {name!r}",
                remedy="make it of boxes, balls, cylinders, capsules and convex meshes",
            )
    friction = [float(model.geom_friction[g, 0]) for g in np.flatnonzero(still)]
    sliding = max(float(model.flex_friction[0, 0]), float(np.mean(friction)) if friction else 0.0)
    return _solids(rows, faces, sliding)


def _solids(
    rows: list[tuple[Floats, Floats, Floats, float, float]], faces: list[Floats], sliding: float
) -> Solids:
    most = max((len(one) for one in faces), default=1)
    planes = np.zeros((len(faces), most, 4))
    for k, one in enumerate(faces):
        planes[k] = one[np.minimum(np.arange(most), len(one) - 1)]  # the last again: no new face
    count = len(rows)
    fields = (
        np.array([row[0] for row in rows]).reshape(count, 3),
        np.array([row[1] for row in rows]).reshape(count, 3, 3),
        np.array([row[2] for row in rows]).reshape(count, 3),
        np.array([row[3] for row in rows]).reshape(count),
        np.array([row[4] for row in rows]).reshape(count),
        planes,
        np.array(sliding),
    )
    return Solids(*(torch.as_tensor(np.asarray(f), dtype=torch.float32)[None] for f in fields))


def _hull(model: mujoco.MjModel, mesh: int, place: Floats, turn: Floats) -> Floats:
    """Planes [F, 4] of a mesh's convex hull, by MuJoCo's own polygons, in the world's frame."""
    first, count = int(model.mesh_polyadr[mesh]), int(model.mesh_polynum[mesh])
    normal = np.array(model.mesh_polynormal[first : first + count]) @ turn.T
    start, verts = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    points = np.array(model.mesh_vert[start : start + verts]) @ turn.T + place
    offset = (points @ normal.T).max(axis=0)  # a hull lies below each of its planes
    return np.concatenate([normal, offset[:, None]], axis=1)


def joined(several: list[Solids]) -> Solids:
    """One batch of scenes; what a scene has less than others is far away."""
    rounds = max(one.centre.shape[1] for one in several)
    flats = max(one.planes.shape[1] for one in several)
    faces = max(one.planes.shape[2] for one in several)
    padded = [_padded(one, rounds, flats, faces) for one in several]
    return Solids(*(torch.cat(field) for field in zip(*padded, strict=True)))


def _padded(one: Solids, rounds: int, flats: int, faces: int) -> Solids:
    scenes, more = len(one.kind), rounds - one.kind.shape[1]
    planes = one.planes
    if planes.shape[1]:  # faces again, then solids below everything
        again = planes[:, :, -1:].expand(-1, -1, faces - planes.shape[2], -1)
        planes = torch.cat([planes, again], dim=2)
    else:
        planes = planes.new_zeros(scenes, 0, faces, 4)
    low = planes.new_tensor([0.0, 0.0, 1.0, -_FAR])
    planes = torch.cat([planes, low.expand(scenes, flats - planes.shape[1], faces, 4)], dim=1)
    return Solids(
        torch.cat([one.centre, one.centre.new_full((scenes, more, 3), -_FAR)], dim=1),
        torch.cat([one.turn, torch.eye(3).expand(scenes, more, 3, 3)], dim=1),
        torch.cat([one.size, one.size.new_zeros(scenes, more, 3)], dim=1),
        torch.cat([one.round, one.round.new_zeros(scenes, more)], dim=1),
        torch.cat([one.kind, one.kind.new_full((scenes, more), _BALL)], dim=1),
        planes,
        one.sliding,
    )


def nearest(solids: Solids, points: Tensor) -> Near:
    """The nearest solid of each point [B, N, 3]; far away and up where there is none.

    Which one it is carries no gradient; distance and normal of that one do.
    """
    up = points.new_tensor([0.0, 0.0, 1.0])
    with torch.no_grad():
        rounded = _rounded_distances(solids, points)
        flat, face = _flat_distances(solids.planes, points)
        least_round, which_round = _least(rounded)
        least_flat, which_flat = _least(flat)
        is_round = least_round < least_flat
        somewhere = torch.minimum(least_round, least_flat) < _FAR
    distance, normal = torch.full_like(points[..., 0], _FAR), up.expand(points.shape)
    if face.shape[2]:
        plane = _plane_of(solids.planes, which_flat, face)
        height = (points * plane[..., :3]).sum(-1) - plane[..., 3]
        distance = torch.where(somewhere, height, distance)
        normal = torch.where(somewhere[..., None], plane[..., :3], normal)
    if rounded.shape[2]:
        own, sense = _from_rounded(solids, which_round, points)
        distance = torch.where(is_round, own, distance)
        normal = torch.where(is_round[..., None], sense, normal)
    return Near(distance, normal)


def _least(distance: Tensor) -> tuple[Tensor, Tensor]:
    """Least of [B, N, K] and its number; far away and 0 where K is 0."""
    if not distance.shape[2]:
        empty = distance.new_full(distance.shape[:2], 2 * _FAR)
        return empty, torch.zeros_like(empty, dtype=torch.long)
    least, which = distance.min(-1)
    return least, which


def _flat_distances(planes: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Distances [B, N, P] from convex solids, and the face that each is from [B, N, P]."""
    batch, count, faces, _ = planes.shape
    if not count:
        none = points.new_zeros(*points.shape[:2], 0)
        return none, none.long()
    flat = planes.reshape(batch, count * faces, 4)
    height = torch.baddbmm(-flat[:, None, :, 3], points, flat[..., :3].transpose(1, 2))
    distance, face = height.reshape(batch, -1, count, faces).max(-1)
    return distance, face


def _plane_of(planes: Tensor, solid: Tensor, face: Tensor) -> Tensor:
    """[B, N, 4]: the face of each point's solid [B, N] that its distance is from."""
    batch, count, faces, _ = planes.shape
    own = face.gather(2, solid[..., None])[..., 0]
    index = (solid * faces + own)[..., None].expand(-1, -1, 4)
    return planes.reshape(batch, count * faces, 4).gather(1, index)


def _rounded_distances(solids: Solids, points: Tensor) -> Tensor:
    """Distances [B, N, R] from boxes, cylinders and balls."""
    batch, count = solids.kind.shape
    axes = solids.turn.permute(0, 2, 1, 3).reshape(batch, 3, count * 3)
    shift = (solids.centre[:, :, None] @ solids.turn).reshape(batch, 1, count * 3)
    own = torch.baddbmm(-shift, points, axes).unflatten(-1, (count, 3))
    over = _over(own, solids.size[:, None], solids.kind[:, None])
    inside = over.amax(-1)
    outside = over.clamp_min(0.0).square().sum(-1).sqrt()
    return torch.where(inside > 0, outside, inside) - solids.round[:, None]


def _over(own: Tensor, size: Tensor, kind: Tensor) -> Tensor:
    """How far points [..., 3] in a solid's frame are beyond its sides [..., 3].

    Each solid is a box in coordinates of its own: |x|, |y|, |z| of a box; distance from the axis
    and |z| of a cylinder; distance from the centre of a ball.
    """
    rho = (own[..., :2].square().sum(-1) + _TINY**2).sqrt()
    far = (own.square().sum(-1) + _TINY**2).sqrt()
    none = torch.full_like(rho, -_FAR)
    piped = torch.stack([rho - size[..., 0], own[..., 2].abs() - size[..., 1], none], dim=-1)
    balled = torch.stack([far - size[..., 0], none, none], dim=-1)
    cylinder, ball = (kind == _CYLINDER)[..., None], (kind == _BALL)[..., None]
    return torch.where(cylinder, piped, torch.where(ball, balled, own.abs() - size))


def _from_rounded(solids: Solids, which: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Distance [B, N] and normal [B, N, 3] of each point from the solid of a number [B, N]."""

    def chosen(field: Tensor) -> Tensor:
        tail = field.shape[2:]
        index = which.reshape(*which.shape, *([1] * len(tail))).expand(*which.shape, *tail)
        return field.gather(1, index)

    turn, size, kind = chosen(solids.turn), chosen(solids.size), chosen(solids.kind)
    own = ((points - chosen(solids.centre))[..., None, :] @ turn)[..., 0, :]
    over = _over(own, size, kind)
    out = over.clamp_min(0.0)
    length = (out.square().sum(-1) + _TINY**2).sqrt()
    deepest = over.amax(-1)
    distance = torch.where(deepest > 0, length, deepest) - chosen(solids.round)
    inner = torch.nn.functional.one_hot(over.argmax(-1), 3).to(out.dtype)
    share = torch.where((deepest > 0)[..., None], out / length[..., None], inner)
    sign = torch.where(own < 0, -1.0, 1.0)
    rho = (own[..., :2].square().sum(-1, keepdim=True) + _TINY**2).sqrt()
    pipe = torch.cat([share[..., :1] * own[..., :2] / rho, share[..., 1:2] * sign[..., 2:]], dim=-1)
    ball = own / (own.square().sum(-1, keepdim=True) + _TINY**2).sqrt()
    is_pipe, is_ball = (kind == _CYLINDER)[..., None], (kind == _BALL)[..., None]
    direction = torch.where(is_pipe, pipe, torch.where(is_ball, ball, share * sign))
    return distance, (turn @ direction[..., None])[..., 0]
