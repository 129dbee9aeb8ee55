"""Candidate contacts between boxes: objects with each other, and the hand's pads with objects.

For each pair the geometry is known: how far apart the boxes are now and would be later in the
step, in which direction and where they would touch, and how fast. `Contacts` gives it to the
network, turns the impulses that the network predicts into changes of velocity, and moves apart
what would overlap.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim_world_model.boxes import Boxes, contact_point, separation
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.normalization import fine
from orbisim_world_model.rotation import product, rotate, rotate_back, to_matrix

SEEN = 16
"""Numbers that one entity sees of a contact with another."""
_CLOSE, _WIDE, _SPEED, _NEAR = 0.002, 0.02, 0.02, 0.03
"""Scales below which gaps (m, twice) and speeds (m/s) are seen finely; gap over which what two
boxes do to each other fades out (m)."""
_TOUCHING = 0.005
"""m: boxes further apart throughout the step exchange no impulse."""
_KICK = 0.3
"""m/s, unit of the speed that an impulse changes."""
_SHY = -3.0
"""At the start of training impulses are a twentieth of the unit."""
_SWEEPS = 2
"""Of moving pairs apart one after another."""


class Geometry(NamedTuple):
    """Of each pair [P].

    Attributes:
      gaps: [B, P, 3] now, in the middle and at the end of the step at constant velocities, m.
      normal: [B, P, 3] from the first to the second. point: [B, P, 3], both in mid-step.
      speed: [B, P, 3] of the second at the point, as the first sees it, m/s.
    """

    gaps: Tensor
    normal: Tensor
    point: Tensor
    speed: Tensor


class Contacts(nn.Module):
    """The pairs of a layout's boxes that may touch.

    Args:
      layout: with the sizes, masses and friction of boxes among the attributes.
    """

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self.timestep, pads, many = layout.timestep, layout.pads, len(layout.objects)
        self.robot, self.slots = int(layout.has_robot), max(len(pads), 1)
        pairs = [(i, j, 0) for i in range(many) for j in range(i + 1, many)]
        self.between = len(pairs)
        pairs += [(many + p, i, p) for p in range(len(pads)) for i in range(many)]
        self.pairs = len(pairs)
        self._keep("one", [a for a, _, _ in pairs], torch.long)
        self._keep("other", [b for _, b, _ in pairs], torch.long)
        tokens = [a + self.robot if a < many else 0 for a, _, _ in pairs]
        self._keep("token_one", tokens, torch.long)
        self._keep("token_other", [b + self.robot for _, b, _ in pairs], torch.long)
        self._keep("slot", [s for _, _, s in pairs], torch.long)
        count = layout.tokens
        places = torch.full((count, count, self.slots), 2 * self.pairs)
        onto = torch.zeros(many, self.pairs)
        for number, (a, b, slot) in enumerate(pairs):
            places[tokens[number], b + self.robot, slot] = number
            places[b + self.robot, tokens[number], slot] = self.pairs + number
            onto[b, number] = 1.0
            if a < many:
                onto[a, number] = -1.0
        self.register_buffer("places", places.flatten(), persistent=False)
        self.register_buffer("onto", onto, persistent=False)
        self._keep("pad_pos", [p.pos for p in pads])
        self._keep("pad_rot", [p.rot for p in pads])
        self._keep("pad_half", [p.half for p in pads])
        self._keep("pad_axis", [p.axis for p in pads])
        self._keep("pad_slides", [float(p.joint >= 0) for p in pads])
        self._keep("pad_joint", [max(p.joint, 0) for p in pads], torch.long)
        self._keep("pad_zero", [p.zero for p in pads])
        self._keep("pad_friction", [p.friction for p in pads])
        for name, wanted in _COLUMNS.items():
            self._keep(name, [layout.attributes.index(column) for column in wanted], torch.long)
        # how deep true boxes overlap, from the training data: objects, then pads
        self.register_buffer("slack", torch.zeros(2))

    @staticmethod
    def suits(layout: Layout) -> bool:
        """Whether a layout has what is needed."""
        needed = {column for columns in _COLUMNS.values() for column in columns}
        several = len(layout.objects) + len(layout.pads) > 1
        return bool(layout.objects) and several and needed <= set(layout.attributes)

    def boxes(self, x: Entities, context: Context) -> Boxes:
        """Objects, then pads, of states that are `completed`."""
        half = context.attributes.index_select(2, self.sizes)
        objects = Boxes(x.pos, to_matrix(x.quat), half, x.vel, x.ang)
        if not len(self.pad_friction):
            return objects
        hand = x.hand_rot[:, None]  # [B, 1, 3, 3]
        out = (x.q.index_select(1, self.pad_joint) - self.pad_zero) * self.pad_slides
        going = x.v.index_select(1, self.pad_joint) * self.pad_slides
        offset = rotate(hand, self.pad_pos + self.pad_axis * out[..., None])  # [B, M, 3]
        ang = x.hand_ang[:, None].expand(offset.shape)
        vel = x.hand_vel[:, None] + torch.linalg.cross(ang, offset)
        pads = Boxes(
            x.hand_pos[:, None] + offset,
            product(hand, self.pad_rot.expand(len(x.pos), -1, 3, 3)),
            self.pad_half.expand(len(x.pos), -1, 3),
            vel + rotate(hand, self.pad_axis * going[..., None]),
            ang,
        )
        return Boxes(*(torch.cat(parts, dim=1) for parts in zip(objects, pads, strict=True)))

    def geometry(self, x: Entities, context: Context) -> Geometry:
        """Of all pairs."""
        boxes, step = self.boxes(x, context), self.timestep
        a, b = boxes.chosen(self.one), boxes.chosen(self.other)
        middle_a, middle_b = a.later(0.5 * step), b.later(0.5 * step)
        gap, normal = separation(middle_a, middle_b)
        first, last = separation(a, b)[0], separation(a.later(step), b.later(step))[0]
        point = contact_point(middle_a, middle_b)
        speed = middle_b.speed_at(point) - middle_a.speed_at(point)
        return Geometry(torch.stack([first, gap, last], dim=-1), normal, point, speed)

    def edges(self, x: Entities, context: Context, given: Geometry, frames: Tensor) -> Tensor:
        """[B, K, K, slots * SEEN]: what each token sees of its contacts, in its own frame.

        Args:
          x: the states. given: their `geometry`.
          frames: [B, K, 3, 3] of the tokens.
        """
        near = torch.exp(-_least(given.gaps).clamp(min=0.0) / _NEAR)[..., None]
        gaps = torch.cat([fine(given.gaps, _CLOSE), fine(given.gaps, _WIDE)], dim=-1)
        inward = (given.speed * given.normal).sum(-1, keepdim=True)
        sliding = given.speed - inward * given.normal
        places = x.pos if not self.robot else torch.cat([self._origin(x)[:, None], x.pos], 1)
        sides = []
        for token, sign in ((self.token_one, 1.0), (self.token_other, -1.0)):
            rot = frames.index_select(1, token)
            arm = given.point - places.index_select(1, token)
            local = [rotate_back(rot, v) for v in (sign * given.normal, arm, sign * sliding)]
            seen = [local[0], local[1], fine(inward, _SPEED), fine(local[2], _SPEED)]
            sides.append(torch.cat([gaps, *(near * part for part in seen)], dim=-1))
        nothing = sides[0].new_zeros((len(x.pos), 1, SEEN))
        every = torch.cat([*sides, nothing], dim=1)  # [B, 2P + 1, SEEN]
        count = x.pos.shape[1] + self.robot
        found = every.index_select(1, self.places)
        return found.reshape(len(x.pos), count, count, self.slots * SEEN)

    def changes(
        self, x: Entities, context: Context, given: Geometry, wanted: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Changes [B, N, 3] of velocity and angular velocity by the impulses of contacts.

        Equal and opposite on both sides, at the point of contact, through mass and inertia; the
        hand's servos take theirs without giving way.

        Args:
          wanted: [B, P, 3], any numbers: the first becomes a normal impulse of at least 0, the
            others its tangential part within the friction cone.
        """
        impulse = self.impulses(context, given, wanted)  # [B, P, 3]
        mass = context.attributes.index_select(2, self.mass)  # [B, N, 1]
        inertia = context.attributes.index_select(2, self.inertia)
        pushed = impulse[:, None] * self.onto[..., None]  # [B, N, P, 3]
        arm = given.point[:, None] - x.pos[:, :, None]
        turning = torch.linalg.cross(arm, pushed).sum(2)  # [B, N, 3]
        rot = to_matrix(x.quat)
        turning = rotate(rot, rotate_back(rot, turning) / inertia.clamp(min=1e-12))
        return pushed.sum(2) / mass.clamp(min=1e-9), turning

    def impulses(self, context: Context, given: Geometry, wanted: Tensor) -> Tensor:
        """[B, P, 3], N s, onto the second of each pair (see `changes`)."""
        within = (1.0 - _least(given.gaps).clamp(min=0.0) / _TOUCHING).clamp(min=0.0)
        mass = self._both(context, self.mass, None)  # [B, P]
        amount = nn.functional.softplus(wanted[..., 0] + _SHY) * _KICK * mass * within
        slide = wanted[..., 1:]
        slide = slide / (1.0 + slide.square().sum(-1, keepdim=True)).sqrt()
        up = torch.zeros_like(given.normal)
        up.select(-1, 2).fill_(1.0)  # a list of numbers would come from the host: no CUDA graph
        flat = torch.linalg.cross(given.normal, up)
        flat = flat / (flat.square().sum(-1, keepdim=True) + 1e-6).sqrt()
        steep = torch.linalg.cross(given.normal, flat)
        grip = self._both(context, self.friction, self.pad_friction)[..., None]
        tangent = grip * (slide[..., :1] * flat + slide[..., 1:] * steep)
        return amount[..., None] * (given.normal + tangent)

    def apart(self, after: Entities, context: Context) -> Entities:
        """A predicted state with overlaps beyond those of the training data undone.

        Pair by pair along the direction of least overlap, by the ratio of masses; what still moves
        inwards there stops.
        """
        for _ in range(_SWEEPS):
            boxes = self.boxes(after, context)
            a, b = boxes.chosen(self.one), boxes.chosen(self.other)
            gap, normal = separation(a, b)
            slack = torch.cat([
                self.slack[:1].expand(self.between),
                self.slack[1:].expand(self.pairs - self.between),
            ])  # fmt: skip
            depth = (-gap - slack).clamp(min=0.0)
            speed = ((b.vel - a.vel) * normal).sum(-1)
            stop = torch.where(depth > 0.0, (-speed).clamp(min=0.0), torch.zeros_like(speed))
            share = self._shares(context)  # [B, N, P]
            after = after._replace(
                pos=after.pos + (share * depth[:, None])[..., None].mul(normal[:, None]).sum(2),
                vel=after.vel + (share * stop[:, None])[..., None].mul(normal[:, None]).sum(2),
            )
        return after

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def fit(self, x: Entities, context: Context) -> None:
        """Takes from true states [B] how deep boxes overlap."""
        boxes = self.boxes(x, context)
        gap, _ = separation(boxes.chosen(self.one), boxes.chosen(self.other))
        there = self._there(context)
        for kind, part in enumerate((slice(0, self.between), slice(self.between, None))):
            depth = -gap[:, part][there[:, part] > 0]
            depth = depth[depth > 0.0]  # of those that overlap at all
            if depth.numel():
                place = max(1, round(_USUAL * depth.numel()))
                self.slack[kind] = depth.kthvalue(place).values

    # -- parts ---------------------------------------------------------------------------------

    def _origin(self, x: Entities) -> Tensor:
        return x.hand_pos if x.hand.shape[1] else torch.zeros_like(x.pos[:, 0])

    def _there(self, context: Context) -> Tensor:
        """[B, P]: whether both of a pair are there."""
        if context.mask is None:
            return context.attributes.new_ones((len(context.attributes), self.pairs))
        pads = len(self.pad_friction)
        mask = torch.cat([context.mask, context.mask.new_ones((len(context.mask), pads))], 1)
        return mask.index_select(1, self.one) * mask.index_select(1, self.other)

    def _both(self, context: Context, column: Tensor, pads: Tensor | None) -> Tensor:
        """[B, P]: reduced mass of a pair; with `pads` their friction, the larger of the two."""
        own = context.attributes.index_select(2, column)[..., 0]
        b = own.index_select(1, self.other)
        first = self.one[: self.between]
        a = own.index_select(1, first)
        b_free, b_pads = b[:, : self.between], b[:, self.between :]
        if pads is None:
            joint = a * b_free / (a + b_free).clamp(min=1e-9)
            return torch.cat([joint * self._there(context)[:, : self.between], b_pads], dim=1)
        hard = pads.index_select(0, self.slot[self.between :]) if len(pads) else b_pads[0]
        return torch.cat(
            [torch.maximum(a, b_free), torch.maximum(b_pads, hard.expand(b_pads.shape))], dim=1
        )

    def _shares(self, context: Context) -> Tensor:
        """[B, N, P]: how far each object goes of a pair's way apart, with its sign."""
        mass = context.attributes.index_select(2, self.mass)  # [B, N, 1]
        light = self.onto.abs() / mass.clamp(min=1e-9)
        there = self._there(context)[:, None]
        return self.onto * there * light / light.sum(1, keepdim=True).clamp(min=1e-12)

    def _keep(self, name: str, values: object, kind: torch.dtype = torch.float32) -> None:
        self.register_buffer(name, torch.tensor(values, dtype=kind), persistent=False)


_COLUMNS = {
    "sizes": ("half_x", "half_y", "half_z"),
    "mass": ("mass",),
    "inertia": ("inertia_x", "inertia_y", "inertia_z"),
    "friction": ("friction_slide",),
}
_USUAL = 0.98
"""Share of the overlapping pairs of the training data that no prediction overlaps deeper than."""


def _least(gaps: Tensor) -> Tensor:
    """The least of three gaps [..., 3]."""
    away = -gaps
    return -torch.maximum(torch.maximum(away[..., 0], away[..., 1]), away[..., 2])
