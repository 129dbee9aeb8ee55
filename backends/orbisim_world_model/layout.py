"""`Layout`: which numbers of a scene's state belong to which entity. Knows no MuJoCo."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim_world_model.entities import Entities
from orbisim_world_model.plain import checked
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
class Pad:
    """A box of the hand that objects can touch, in the frame of the hand's site.

    Attributes:
      pos: [3] its centre, m, where its joint is at `zero`. rot: [3, 3] its axes, in columns.
      half: [3] half sides, m.
      joint: the slide joint between hand and pad (index into `Layout.joints`), or -1.
      axis: [3] of that joint. zero: its position there, m.
      friction: sliding coefficient.
    """

    pos: tuple[float, float, float]
    rot: tuple[Any, ...]
    half: tuple[float, float, float]
    joint: int = -1
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zero: float = 0.0
    friction: float = 0.0


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
      pads: boxes of the hand.
      parts: joints of mechanisms (indices into `joints`), each with a token of its own; a part
        stands after the one that carries it. part_columns: names of the columns of their
        descriptors. Of an articulated layout they are all joints of a robot.
      substeps, runge_kutta: how many steps of MuJoCo's make a step, at most, and whether these are
        of fourth order (an articulated layout's).
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
    pads: tuple[Pad, ...] = ()
    parts: tuple[int, ...] = ()
    part_columns: tuple[str, ...] = ()
    substeps: int = 1
    runge_kutta: bool = False

    @property
    def articulated(self) -> bool:
        """Whether the parts are the limbs of a robot (see `articulation`)."""
        return "control" in self.part_columns

    @property
    def robot_token(self) -> bool:
        """Whether the robot as a whole has a token."""
        return self.has_robot and not self.articulated

    @property
    def has_robot(self) -> bool:
        """Whether there is a robot."""
        return bool(self.joints)

    @property
    def tokens(self) -> int:
        """Number of tokens: the robot, if there is one, the objects and the parts."""
        return int(self.robot_token) + len(self.objects) + len(self.parts)

    @property
    def robot_joints(self) -> tuple[int, ...]:
        """The joints that are no part's."""
        return tuple(j for j in range(len(self.joints)) if j not in self.parts)

    @property
    def robot(self) -> tuple[tuple[str, bool], ...]:
        """Names of the robot's joints, and whether they turn."""
        return tuple((self.joints[j], self.hinge[j]) for j in self.robot_joints)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any], where: str = "layout") -> Layout:
        """From JSON.

        Args:
          values: as `to_dict` gives them.
          where: named in errors.

        Raises:
          InputError: an entry is missing, unknown, of the wrong type, or points nowhere.
        """
        layout = checked(Layout, values, where)
        if problem := _problem(layout):
            raise InputError(f"{where}: {problem}")
        return layout

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


_MOST = 100_000
"""Of coordinates, activations and controls, each."""
_MOST_SUBSTEPS = 1000
"""Of MuJoCo's steps in one: the finest scenes take some hundred for a control step."""


def _problem(x: Layout) -> str:
    """What is wrong with a layout from outside, in words; empty if nothing is."""
    for name in ("nq", "nv", "na", "nu"):
        if not 0 <= getattr(x, name) <= _MOST:
            return f"{name} is {getattr(x, name)}; expected 0 to {_MOST}"
    if not 1 <= x.substeps <= _MOST_SUBSTEPS:
        return f"substeps is {x.substeps}; expected 1 to {_MOST_SUBSTEPS}"
    if not 0.0 < x.timestep < 1e6:
        return f"timestep is {x.timestep:g} s; expected a duration above 0"
    lengths = {n: len(getattr(x, n)) for n in ("joint_q", "joint_v", "hinge", "bounded", "ignored")}
    lengths |= {name: len(getattr(x, name)) for name in ("object_q", "object_v")}
    for name, count in lengths.items():
        expected = len(x.objects if name.startswith("object") else x.joints)
        if count != expected:
            return f"{name} has {count} entries; expected {expected}"
    places_q = sorted([*x.joint_q, *(q + i for q in x.object_q for i in range(7))])
    places_v = sorted([*x.joint_v, *(v + i for v in x.object_v for i in range(6))])
    if places_q != list(range(x.nq)) or places_v != list(range(x.nv)):
        return "the addresses of joints and objects do not make up nq and nv"
    known = _chain_problem(x) or _limbs_problem(x.limbs, len(x.joints)) or _pads_problem(x)
    return known or _parts_problem(x)


def _chain_problem(x: Layout) -> str:
    joints = range(len(x.joints))
    if not set(x.chain_joints) <= set(joints) or not set(x.servo) <= {-1, *joints}:
        return "chain_joints or servo name a joint that is not there"
    if len(x.servo) not in (0, x.nu):
        return f"servo has {len(x.servo)} entries; expected {x.nu}"
    if not x.hand:
        return ""
    if not x.chain_joints:
        return "a hand needs a chain of joints"
    chain = _has_shape(x.chain, (len(x.chain_joints), 4, 4, 4))
    return "" if chain and _has_shape(x.tip, (4, 4)) else "chain or tip have the wrong shape"


def _limbs_problem(limbs: Limbs, joints: int) -> str:
    count, capsules = len(limbs.parents), len(limbs.joints)
    if not count and not capsules:
        return ""
    shapes = (
        (limbs.bases, (joints, 4, 4, 4)),
        (limbs.ends, (capsules, 2, 3)),
        (limbs.limits, (joints, 2)),
    )
    if count != joints or len(limbs.radii) != capsules:
        return "limbs have the wrong number of parents or radii"
    if not all(_has_shape(values, shape) for values, shape in shapes):
        return "bases, ends or limits of the limbs have the wrong shape"
    known = set(range(capsules))
    if not (
        all(-1 <= parent < number for number, parent in enumerate(limbs.parents))
        and set(limbs.joints) <= set(range(joints))
        and {*limbs.grounded, *(one for pair in limbs.pairs for one in pair)} <= known
    ):
        return "limbs name a joint or a capsule that is not there"
    return ""


def _pads_problem(x: Layout) -> str:
    for number, pad in enumerate(x.pads):
        if not x.hand:
            return "pads need a hand"
        if not -1 <= pad.joint < len(x.joints):
            return f"pads[{number}].joint is {pad.joint}; there are {len(x.joints)} joints"
        if not _has_shape(pad.rot, (3, 3)) or min(pad.half) <= 0:
            return f"pads[{number}] is no box"
    return ""


def _parts_problem(x: Layout) -> str:
    if not x.parts:
        return ""
    if x.articulated:
        if x.parts != tuple(range(len(x.joints))) or x.objects or x.hand or x.na:
            return "limbs are all joints of a scene without objects, hand and activations"
    elif not x.hand or set(x.parts) & set(x.chain_joints):
        return "parts need a hand, and are no joints of it"
    if len(set(x.parts)) != len(x.parts) or not set(x.parts) <= set(range(len(x.joints))):
        return "parts name a joint that is not there, or one twice"
    if not x.part_columns:
        return "parts need columns of descriptors"
    return ""


def _has_shape(values: Any, shape: tuple[int, ...]) -> bool:
    """Whether nested tuples hold finite numbers in this shape."""
    try:
        array = np.asarray(values, np.float64)
    except (ValueError, TypeError, OverflowError):
        return False
    if not shape[0]:  # nested tuples of nothing have no further axes
        return array.shape == (0,)
    return array.shape == shape and bool(np.isfinite(array).all())
