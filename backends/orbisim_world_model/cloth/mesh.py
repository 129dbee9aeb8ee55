"""The cloth of a scene: its vertices, edges and triangles, and its state in tensors."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from torch import Tensor

from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.tasks.cloth import free_vertices

MOST_NEIGHBOURS = 32
"""Edges of one vertex; a triangulated grid has 6."""


class Cloth(NamedTuple):
    """Positions and velocities [..., V, 3] of the vertices in the world's frame, m and m/s."""

    pos: Tensor
    vel: Tensor

    def at(self, index: Any) -> Cloth:
        """The same at an index of the leading axis."""
        return Cloth(self.pos[index], self.vel[index])

    def detach(self) -> Cloth:
        """Without gradients."""
        return Cloth(self.pos.detach(), self.vel.detach())


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """A cloth at rest.

    Attributes:
      edge: [E, 2] vertices. rest: [E] lengths, m.
      flat: [V, 3] where the vertices are at the reference configuration, about their mean, m.
      neighbour: [V, N] other ends of each vertex' edges, and itself where it has fewer.
      along: [V, N] numbers of these edges; E where it has fewer.
      mass: [V], kg. radius: m.
      address: [V, 3] in qpos; offset: [V, 3] positions are qpos[address] + offset. dof: [V, 3] in
        qvel.
      nq, nv: of the scene. timestep: of a learned step, s. gravity: [3], m/s^2.
    """

    edge: Tensor
    rest: Tensor
    flat: Tensor
    neighbour: Tensor
    along: Tensor
    mass: Tensor
    radius: float
    address: Tensor
    offset: Tensor
    dof: Tensor
    nq: int
    nv: int
    timestep: float
    gravity: Tensor

    @property
    def vertices(self) -> int:
        """Their number."""
        return len(self.mass)

    def to(self, device: torch.device | str) -> Mesh:
        """On a device."""
        moved = {
            field.name: value.to(device)
            for field in dataclasses.fields(self)
            if isinstance(value := getattr(self, field.name), Tensor)
        }
        return dataclasses.replace(self, **moved)

    def split(self, qpos: Tensor, qvel: Tensor, act: Tensor | None = None) -> Cloth:
        """The cloth of coordinates [..., nq] and velocities [..., nv]; it has no activations."""
        return Cloth(qpos[..., self.address] + self.offset, qvel[..., self.dof])

    def join(self, x: Cloth) -> tuple[Tensor, Tensor, Tensor]:
        """Coordinates [..., nq], velocities [..., nv], activations [..., 0]; undoes `split`."""
        order_q, order_v = self.address.reshape(-1).argsort(), self.dof.reshape(-1).argsort()
        qpos = (x.pos - self.offset).flatten(-2)[..., order_q]
        return qpos, x.vel.flatten(-2)[..., order_v], qpos[..., :0]


def read_mesh(model: mujoco.MjModel, timestep: float, source: str = "scene") -> Mesh:
    """The cloth of a scene.

    Args:
      timestep: of a learned step, s.

    Raises:
      UnsupportedSceneError: the scene has not one flex of free vertices, or more that moves.
    """
    try:
        address, offset = free_vertices(model)
    except InputError as error:
        raise UnsupportedSceneError(source, f"a learned cloth: {error}") from None
    _check_alone(model, address.size, source)
    edge = np.array(model.flex_edge, np.int64)
    neighbour, along = _neighbours(edge, len(address), source)
    flat = np.array(model.qpos0)[address] + offset
    bodies = np.array(model.flex_vertbodyid)
    first = model.jnt_dofadr[model.body_jntadr[bodies]]
    return Mesh(
        edge=torch.as_tensor(edge),
        rest=_float(model.flexedge_length0),
        flat=_float(flat - flat.mean(axis=0)),
        neighbour=torch.as_tensor(neighbour),
        along=torch.as_tensor(along),
        mass=_float(model.body_mass[bodies]),
        radius=float(model.flex_radius[0]),
        address=torch.as_tensor(address),
        offset=_float(offset),
        dof=torch.as_tensor(np.asarray(first[:, None] + np.arange(3), np.int64)),
        nq=int(model.nq),
        nv=int(model.nv),
        timestep=timestep,
        gravity=_float(model.opt.gravity),
    )


def _check_alone(model: mujoco.MjModel, coordinates: int, source: str) -> None:
    """Raises `UnsupportedSceneError` if more moves than the cloth, or something moves it."""
    if model.nq != coordinates:
        raise UnsupportedSceneError(
            source,
            f"a learned cloth moves alone; the scene has {model.nq - coordinates} coordinates "
            "besides",
        )
    if model.nu or model.na:
        raise UnsupportedSceneError(
            source, f"a learned cloth has no controls; the scene has {model.nu} actuators"
        )
    if (model.dof_damping != 0).any() or (model.jnt_stiffness != 0).any():
        raise UnsupportedSceneError(
            source, "joints of the cloth's vertices have damping or springs; learned cloth has none"
        )
    if not (model.flex_edgeequality[0] or model.flex_edgestiffness[0]):
        raise UnsupportedSceneError(source, "nothing keeps the lengths of the flex's edges")


def _neighbours(edge: Any, count: int, source: str) -> tuple[Any, Any]:
    """Other ends and numbers of each vertex' edges, [V, N] each."""
    lists: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for number, (a, b) in enumerate(edge.tolist()):
        lists[a].append((b, number))
        lists[b].append((a, number))
    most = max(map(len, lists), default=0)
    if not 0 < most <= MOST_NEIGHBOURS:
        raise UnsupportedSceneError(
            source, f"a vertex of the flex has {most} edges; 1 to {MOST_NEIGHBOURS} are read"
        )
    neighbour = np.tile(np.arange(count)[:, None], (1, most))
    along = np.full((count, most), len(edge))
    for vertex, pairs in enumerate(lists):
        for place, (other, number) in enumerate(pairs):
            neighbour[vertex, place], along[vertex, place] = other, number
    return neighbour, along


def _float(values: Any) -> Tensor:
    return torch.as_tensor(np.array(values), dtype=torch.float32)
