"""`Layout`: which numbers of a scene's state belong to which entity. Knows no MuJoCo."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbisim_world_model.entities import Entities
from orbisim_world_model.rotation import normalized, rotate, rotate_back, to_matrix


@dataclasses.dataclass(frozen=True)
class Limbs:
    """The moving parts of a robot whose joints are all hinges and slides.

    J joints, C capsules (a sphere is one without length).

    Attributes:
      parents: [J] the joint before each joint, or -1. bases: [J, 4, 4, 4] as `Layout.chain`, from
        the parent joint's frame.
      joints: [C] the joint that moves each capsule. ends: [C, 2, 3] the ends of its axis in that
        joint's frame, m. radii: [C], m.
      grounded: capsules that can touch the floor. height: of the floor, m.
      pairs: pairs of capsules that can touch each other.
      limits: [J, 2] range of each joint, rad or m; both 0 where it has none.
    """

    parents: tuple[int, ...] = ()
    bases: tuple[Any, ...] = ()
    joints: tuple[int, ...] = ()
    ends: tuple[Any, ...] = ()
    radii: tuple[float, ...] = ()
    grounded: tuple[int, ...] = ()
    height: float = 0.0
    pairs: tuple[tuple[int, int], ...] = ()
    limits: tuple[tuple[float, float], ...] = ()


@dataclasses.dataclass(frozen=True)
class Layout:
    """Where the entities stand in (qpos, qvel, act, ctrl).

    All hinge and slide joints of a scene are coordinates of the robot token, in the order of qvel.

    Attributes:
      nq, nv, na, nu: sizes of the scene's state and control.
      joints: names of the scalar joints. joint_q, joint_v: their addresses in qpos and qvel.
      hinge: whether the joint turns (else it slides).
      bounded: whether its range is limited; an unlimited hinge is seen through sine and cosine.
      ignored: whether the dynamics do not depend on its position (root of a planar walker).
      objects: names of the free bodies. object_q, object_v: first addresses.
      attributes, settings: names of the columns of object attributes and world settings.
      hand: site at the robot's hand, or empty. surface: geom of the supporting surface, or empty.
      chain: matrices [joints of the hand's chain, 4, 4, 4]: local transform = chain . (1, sin q,
        cos q, q); chain_joints: indices into `joints`; tip: [4, 4], hand in the last frame.
      servo: for each control, the joint whose position it commands, or -1.
      ground: height of the plane on which objects come to rest, m.
      invariant: whether moving and turning everything in the horizontal plane changes nothing.
      timestep: the control step, s.
      limbs: the robot's moving parts and what they can touch.
    """

    nq: int
    nv: int
    na: int
    nu: int
    timestep: float
    joints: tuple[str, ...] = ()
    joint_q: tuple[int, ...] = ()
    joint_v: tuple[int, ...] = ()
    hinge: tuple[bool, ...] = ()
    bounded: tuple[bool, ...] = ()
    ignored: tuple[bool, ...] = ()
    objects: tuple[str, ...] = ()
    object_q: tuple[int, ...] = ()
    object_v: tuple[int, ...] = ()
    attributes: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    hand: str = ""
    surface: str = ""
    chain: tuple[Any, ...] = ()
    chain_joints: tuple[int, ...] = ()
    tip: tuple[Any, ...] = ()
    servo: tuple[int, ...] = ()
    ground: float = 0.0
    invariant: bool = False
    limbs: Limbs = Limbs()

    @property
    def has_robot(self) -> bool:
        """Whether there is a robot token."""
        return bool(self.joints)

    @property
    def tokens(self) -> int:
        """Number of tokens: the robot, if there is one, and the objects."""
        return int(self.has_robot) + len(self.objects)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Layout:
        """From JSON."""
        fields = {name: _tuples(value) for name, value in values.items() if name != "limbs"}
        limbs = {name: _tuples(value) for name, value in values.get("limbs", {}).items()}
        return Layout(**fields, limbs=Limbs(**limbs))

    # -- states --------------------------------------------------------------------------------

    def split(self, qpos: Tensor, qvel: Tensor, act: Tensor) -> Entities:
        """The entities of generalized coordinates [B, nq], [B, nv], [B, na]; `hand` is empty.

        A free joint's angular velocity is in the body's frame in MuJoCo and in the world's here.
        """
        index = self._indices(str(qpos.device))
        pos, quat = qpos[:, index["pos"]], normalized(qpos[:, index["quat"]])
        vel, local = qvel[:, index["vel"]], qvel[:, index["ang"]]
        return Entities(
            qpos[:, index["q"]],
            qvel[:, index["v"]],
            act,
            qpos[:, :0],
            pos,
            quat,
            vel,
            rotate(to_matrix(quat), local),
        )

    def join(self, x: Entities) -> tuple[Tensor, Tensor, Tensor]:
        """qpos [B, nq], qvel [B, nv] and act [B, na] of the entities."""
        free_q = torch.cat([x.pos, x.quat], dim=-1).flatten(1)
        local = rotate_back(to_matrix(x.quat), x.ang)
        free_v = torch.cat([x.vel, local], dim=-1).flatten(1)
        index = self._indices(str(x.q.device))
        qpos = torch.cat([x.q, free_q], dim=1)[:, index["to_qpos"]]
        qvel = torch.cat([x.v, free_v], dim=1)[:, index["to_qvel"]]
        return qpos, qvel, x.act

    def _indices(self, device: str) -> dict[str, Tensor]:
        return _indices(self, device)


@functools.lru_cache(maxsize=64)
def _indices(layout: Layout, device: str) -> dict[str, Tensor]:
    free_q, free_v = np.asarray(layout.object_q, int), np.asarray(layout.object_v, int)
    q, v = np.asarray(layout.joint_q, int), np.asarray(layout.joint_v, int)
    all_q = np.concatenate([q, (free_q[:, None] + np.arange(7)).ravel()])
    all_v = np.concatenate([v, (free_v[:, None] + np.arange(6)).ravel()])
    found = {
        "q": q,
        "v": v,
        "pos": free_q[:, None] + np.arange(3),
        "quat": free_q[:, None] + np.arange(3, 7),
        "vel": free_v[:, None] + np.arange(3),
        "ang": free_v[:, None] + np.arange(3, 6),
        "to_qpos": np.argsort(all_q),
        "to_qvel": np.argsort(all_v),
    }
    return {name: torch.as_tensor(value, device=device) for name, value in found.items()}


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, (list, tuple)) else value
