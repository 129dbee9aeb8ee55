"""Parts of mechanisms: where their joints put them, and what the network sees of them.

A part is a body that one hinge or slide moves and no motor does. Its joint's coordinate stands
among the scalar joints of a scene (`Entities.q`); what else there is to know of it, the descriptor
columns below, differs from instance to instance and comes with the `Context` (paper, appendix B.4).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.kinematics import Kinematics
from orbisim_world_model.layout import Layout
from orbisim_world_model.normalization import fine
from orbisim_world_model.rotation import exponential, product, rotate, rotate_back, to_matrix

TOKEN = 64
"""Numbers of a shape's token (see `geometry`)."""
JOINT = (
    *("parent", "type_hinge", "low", "high", "reference"),
    *("axis_x", "axis_y", "axis_z", "anchor_x", "anchor_y", "anchor_z"),
    *("stiffness", "springref", "damping", "frictionloss", "armature"),
)
"""Metadata of a part's joint: the part that it is attached to (its number, -1 for what does not
move), type, range, coordinate in the reference pose, axis and anchor in the part's frame, and what
acts along it; rad or m, N m or N."""
BODY = (
    *("half_x", "half_y", "half_z", "mass", "inertia_x", "inertia_y", "inertia_z"),
    *("centre_x", "centre_y", "centre_z", "friction_slide"),
)
"""Of the part itself; half sizes and centre are those of its bounding box in its frame, m."""
PLACE = ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
"""Pose of the part's frame in its parent's, at the reference coordinate; in the world's without
a parent."""
SHAPE = tuple(f"shape_{number:02d}" for number in range(TOKEN))
"""The geometry token."""
COLUMNS = (*JOINT, *BODY, *PLACE, *SHAPE)
RELATIONS = 2
"""Numbers of a pair of tokens beside poses: whether one is attached to the other."""
OUTPUTS = 3
"""Numbers that the decoder gives for a part: of its joint's position and velocity, and of how
firmly the hand carries it."""
FREE = -30.0
"""The last of these for a part that the hand does not carry."""
_ROOM = 0.01
"""Share of a joint's range by which soft limits give way."""
_ANGLE, _LENGTH, _SPEED, _PULL = 0.02, 0.005, 0.02, 0.01
"""Scales below which coordinates (rad, m), speeds and the hand's error (m) are seen finely."""
_NEAR = 2e-5  # m^2, so that a hand on the axis turns nothing infinitely fast


class Placed(NamedTuple):
    """Parts in the world frame.

    Attributes:
      pos: [B, P, 3] of the centre, m. rot: [B, P, 3, 3]. vel, ang: [B, P, 3] of the centre.
      axis, anchor: [B, P, 3] of the joint.
    """

    pos: Tensor
    rot: Tensor
    vel: Tensor
    ang: Tensor
    axis: Tensor
    anchor: Tensor


class Parts(nn.Module):
    """Kinematics and features of a layout's parts.

    Args:
      layout: with parts.
      config: says what the network sees.
    """

    def __init__(self, layout: Layout, config: ModelConfig) -> None:
        super().__init__()
        self.config, self.timestep = config, layout.timestep
        self.kinematics = Kinematics(layout)
        # a buffer, so that nothing is copied from the host while a CUDA graph is recorded
        self.register_buffer("unit", torch.tensor([1.0, 0.0, 0.0, 0.0]), persistent=False)
        own = layout.robot_joints
        order = [0] * len(layout.joints)
        for place, joint in enumerate((*own, *layout.parts)):
            order[joint] = place
        self._index("joints", layout.parts)
        self._index("own", own)
        self._index("order", order)
        served = [(u, joint) for u, joint in enumerate(layout.servo) if joint in own]
        self._index("servos", [u for u, _ in served])
        command = list(range(len(layout.joints)))
        for place, (_, joint) in enumerate(served):
            command[joint] = len(layout.joints) + place
        self._index("command", command)
        known = (*BODY, *(JOINT[1:] if config.joints else ()), *(SHAPE if config.geometry else ()))
        self._index("seen", [COLUMNS.index(name) for name in known])

    def column(self, context: Context, name: str, count: int = 1) -> Tensor:
        """[B, P] or [B, P, count]: columns of the descriptor from a name on."""
        assert context.parts is not None
        first = COLUMNS.index(name)
        found = context.parts[..., first : first + count]
        return found[..., 0] if count == 1 else found

    def attributes(self, context: Context) -> Tensor:
        """[B, P, D]: what conditions a part's token."""
        assert context.parts is not None
        return context.parts.index_select(2, self.seen)

    def coordinates(self, x: Entities) -> tuple[Tensor, Tensor]:
        """[B, P] positions and velocities of the joints."""
        return x.q.index_select(1, self.joints), x.v.index_select(1, self.joints)

    def attached(self, context: Context) -> Tensor:
        """[B, P, P]: 1 where the second part carries the first."""
        numbers = torch.arange(len(self.joints), device=context.world.device)
        return (self.column(context, "parent")[..., None] == numbers).to(context.world.dtype)

    def placed(self, x: Entities, context: Context) -> Placed:
        """Where the parts are and how they move; each after the one that carries it."""
        q, v = self.coordinates(x)
        carried = self.attached(context)
        hinge = self.column(context, "type_hinge")[..., None]
        turned, along = (q - self.column(context, "reference"))[..., None], v[..., None]
        axis, anchor = (self.column(context, name, 3) for name in ("axis_x", "anchor_x"))
        centre = self.column(context, "centre_x", 3)
        base, lies = self.column(context, "base_x", 3), to_matrix(self._lies(context))
        spin = to_matrix(exponential(axis * turned * hinge))
        eye = torch.eye(3, device=q.device, dtype=q.dtype).expand(len(q), 3, 3)
        zero = q.new_zeros((len(q), 3))
        frames: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
        found: list[tuple[Tensor, ...]] = []
        for i in range(len(self.joints)):
            pos, rot, vel, ang = zero, eye, zero, zero
            for j, (p, r, u, w) in enumerate(frames):
                on = carried[:, i, j, None]
                rot = rot + on[..., None] * (r - eye)
                pos, vel, ang = pos + on * p, vel + on * u, ang + on * w
            start = product(rot, lies[:, i])
            origin = pos + rotate(rot, base[:, i])
            way = rotate(start, axis[:, i])
            pivot = origin + rotate(start, anchor[:, i])
            now = product(start, spin[:, i])
            slid = way * turned[:, i] * (1.0 - hinge[:, i])
            place = pivot - rotate(now, anchor[:, i]) + slid
            turning = way * along[:, i] * hinge[:, i]
            speed = vel + torch.linalg.cross(ang, place - pos)
            speed = speed + torch.linalg.cross(turning, place - pivot)
            speed = speed + way * along[:, i] * (1.0 - hinge[:, i])
            frames.append((place, now, speed, ang + turning))
            arm = rotate(now, centre[:, i])
            moving = speed + torch.linalg.cross(ang + turning, arm)
            found.append((place + arm, now, moving, ang + turning, way, pivot))
        return Placed(*(torch.stack(field, dim=1) for field in zip(*found, strict=True)))

    def _lies(self, context: Context) -> Tensor:
        """[B, P, 4]; a part that is not there lies as its parent does."""
        quat = self.column(context, "base_qw", 4)
        empty = (quat.square().sum(-1, keepdim=True) < 0.5).to(quat.dtype)
        return quat + empty * self.unit

    def features(self, x: Entities, control: Tensor, context: Context) -> Tensor:
        """[B, P, F]: of the joint, of the part, and of the hand as seen along the joint.

        Without `config.joints`, the coordinates and the pose alone.
        """
        (q, v), now = self.coordinates(x), self.placed(x, context)
        q, v = q[..., None], v[..., None]
        up = now.rot[..., 2, :]
        parts = [q, q.sin(), q.cos(), fine(q, _ANGLE), v, fine(v, _SPEED), now.pos, up]
        if not self.config.joints:
            return torch.cat(parts, dim=-1)
        hinge = self.column(context, "type_hinge")[..., None]
        low, high = (self.column(context, name)[..., None] for name in ("low", "high"))
        room = torch.cat([q - low, high - q], dim=-1)
        way, radius = self._way(x, now, hinge)
        with_hand = (way * x.hand_vel[:, None]).sum(-1, keepdim=True)
        error = self._commanded(x, control) - x.hand_pos
        pull = (way * error[:, None]).sum(-1, keepdim=True)
        error = rotate_back(now.rot, error[:, None].expand_as(now.pos))
        parts += [
            *(room, fine(room, _ANGLE), fine(room, _LENGTH), now.axis, radius * hinge),
            *(with_hand, fine(with_hand - v, _SPEED), fine(pull, _PULL), fine(error, _PULL)),
        ]
        return torch.cat(parts, dim=-1)

    def _way(self, x: Entities, now: Placed, hinge: Tensor) -> tuple[Tensor, Tensor]:
        """[B, P, 3] whose product with the hand's velocity is that of a joint that goes with the
        hand, and [B, P, 1] the hand's distance from its axis, m."""
        arm = x.hand_pos[:, None] - now.anchor
        arm = arm - now.axis * (arm * now.axis).sum(-1, keepdim=True)
        about = torch.linalg.cross(now.axis, arm)
        square = about.square().sum(-1, keepdim=True)
        way = hinge * about / (square + _NEAR) + (1.0 - hinge) * now.axis
        return way, (square + _NEAR).sqrt()

    def carried(self, x: Entities, after: Entities, share: Tensor, context: Context) -> Entities:
        """The next state with parts that the hand carries moving with it.

        Args:
          x: the state before. after: what follows without the hand, but with the hand's pose.
          share: [B, P], 0 where the hand does not carry the part, 1 where it does so rigidly.
        """
        if not self.config.joints:
            return after
        hinge = self.column(context, "type_hinge")[..., None]
        way, _ = self._way(x, self.placed(x, context), hinge)
        hand = (way * after.hand_vel[:, None]).sum(-1)
        q, v = self.coordinates(after)
        more = share * (hand - v)
        q = q + 0.5 * self.timestep * more
        return after._replace(q=self.merged(after.q, q), v=self.merged(after.v, v + more))

    def _commanded(self, x: Entities, control: Tensor) -> Tensor:
        """[B, 3]: where the hand would be if all servos had reached their targets."""
        targets = torch.cat([x.q, control.index_select(1, self.servos)], dim=1)
        q = targets.index_select(1, self.command)
        return self.kinematics(q, torch.zeros_like(q))[:, :3]

    def relations(self, context: Context, before: int) -> Tensor:
        """[B, K, K, 2]: whether token j carries token i, and the other way round.

        Args:
          before: number of tokens before the parts.
        """
        carried = nn.functional.pad(self.attached(context), (before, 0, before, 0))
        return torch.stack([carried, carried.transpose(1, 2)], dim=-1)

    def limited(self, x: Entities, context: Context) -> Entities:
        """The state with no part beyond its joint's range, nor moving on out of it."""
        if not self.config.joints:
            return x
        q, v = self.coordinates(x)
        low, high = self.column(context, "low"), self.column(context, "high")
        room = _ROOM * (high - low)
        kept = torch.minimum(torch.maximum(q, low - room), high + room)
        outward = (q - kept) * v > 0
        v = torch.where(outward, torch.zeros_like(v), v)
        return x._replace(q=self.merged(x.q, kept), v=self.merged(x.v, v))

    def merged(self, every: Tensor, parts: Tensor) -> Tensor:
        """[B, J] with the parts' entries [B, P] replaced."""
        return self.joined(every.index_select(1, self.own), parts)

    def joined(self, own: Tensor, parts: Tensor) -> Tensor:
        """[B, J] of the robot's entries and the parts' [B, P], in the layout's order."""
        return torch.cat([own, parts], dim=1).index_select(1, self.order)

    def whole(self, robot: Tensor, parts: Tensor) -> Tensor:
        """The decoder's numbers of the robot and of the parts [B, P, 2], as those of all joints."""
        count = len(self.own)
        dq, dv, act = robot[:, :count], robot[:, count : 2 * count], robot[:, 2 * count :]
        return torch.cat([self.joined(dq, parts[..., 0]), self.joined(dv, parts[..., 1]), act], 1)

    def split(self, raw: Tensor) -> tuple[Tensor, Tensor]:
        """The inverse of `whole`: the robot's numbers, and the parts' [B, P, 2]."""
        count = len(self.order)
        dq, dv, act = raw[:, :count], raw[:, count : 2 * count], raw[:, 2 * count :]
        robot = torch.cat([dq.index_select(1, self.own), dv.index_select(1, self.own), act], dim=1)
        return robot, torch.stack([part.index_select(1, self.joints) for part in (dq, dv)], dim=-1)

    def by_type(self, values: Tensor, context: Context) -> Tensor:
        """[B, P, 4] of [B, P, 2]: of hinges, then of slides, 0 where the part is of the other."""
        hinge = self.column(context, "type_hinge")[..., None]
        return torch.cat([values * hinge, values * (1.0 - hinge)], dim=-1)

    def chosen(self, scale: Tensor, context: Context) -> Tensor:
        """[B, P, 2]: of scales [4], those of each part's type of joint."""
        hinge = self.column(context, "type_hinge")[..., None]
        return hinge * scale[:2] + (1.0 - hinge) * scale[2:]

    def _index(self, name: str, values: tuple[int, ...] | list[int]) -> None:
        self.register_buffer(name, torch.tensor(values, dtype=torch.long), persistent=False)
