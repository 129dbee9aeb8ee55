"""Robots as one token a joint: everything about a body is a number, nothing belongs to one robot.

Each hinge or slide is a limb with the mass and the capsules of what it moves. Where limbs are, what
inertia, gravity, springs, damping and motors do to them, and where they may touch follows from the
columns below; the network says what constraints do: contacts with the floor and of limbs with each
other, limits of joints and dry friction. It gives impulses, which act along the Jacobians of their
points through the inverse of the inertia matrix (as equation (5) of Todorov, "Convex and
analytically-invertible dynamics with contacts and constraints", 2014, has them).

Shapes: B worlds, P limbs, C = 4 ends of two capsules.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.mechanics import Free, Mechanics, Motion, along, applied
from orbisim_world_model.normalization import fine
from orbisim_world_model.parts import JOINT, PLACE
from orbisim_world_model.touch import closest

SWITCHES = ("limited", "ignored", "implicit", "heavy")
"""Whether the joint has a range; whether nothing depends on its position; what of its damping
MuJoCo integrates implicitly, N m s or N s/m; whether gravity acts."""
INERTIA = (
    *("mass", "com_x", "com_y", "com_z", "inertia_xx", "inertia_yy", "inertia_zz"),
    *("inertia_xy", "inertia_xz", "inertia_yz"),
)
"""Of what the joint moves without another joint between: kg, m and kg m^2 about the centre of mass
in the frame of its body. Where a body has several joints, the last of them has it."""
MOTOR = (
    *("control", "gear", "gain", "bias_0", "bias_1", "bias_2"),
    *("ctrl_low", "ctrl_high", "force_low", "force_high", "motor_implicit"),
)
"""Of the actuator that drives the joint: number of its control (-1: none), MuJoCo's numbers, and
whether its damping is integrated implicitly."""
SURFACE = (
    *("friction", "floor_there", "floor", "meets", "solref_0", "solref_1"),
    *("solimp_0", "solimp_1", "solimp_2", "body", "parent_body"),
)
"""Of contacts: sliding friction, whether the limb can touch the floor and at which height that is,
whether it can touch other limbs, and MuJoCo's softness; numbers of its body and of the one that
carries it, which never touch each other."""
FELT = ("friction", "floor_there", *SURFACE[3:9])
LIMIT = ("limit_solref_0", "limit_solref_1", "limit_solimp_0", "limit_solimp_1", "limit_solimp_2")
CAPSULES = 2
ENDS = 2 * CAPSULES
SHAPE = tuple(
    f"{name}_{number}"
    for number in range(CAPSULES)
    for name in ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "radius", "long", "there")
)
"""Of each of two capsules: the ends of the axis in the body's frame and the radius, m; whether its
ends differ, and whether it is there."""
UNITS = ("unit_q", "unit_v")
"""Typical change of position and velocity in a step of the data, rad or m and rad/s or m/s: what
errors and noise are measured by. The network does not see them."""
LIMB_COLUMNS = (*JOINT, *SWITCHES, *INERTIA, *PLACE, *MOTOR, *SURFACE, *LIMIT, *SHAPE, *UNITS)
SEEN = (
    *("type_hinge", "limited", "damping", "frictionloss", "armature", "stiffness", "mass"),
    *FELT,
    *LIMIT,
    *(f"{name}_{number}" for number in range(CAPSULES) for name in ("radius", "there")),
)
"""What conditions a limb's token."""
IMPULSES = 3 * ENDS + 2 + 3
"""Numbers of one set of impulses: of each end of a capsule inwards and along x and y of the floor,
of the nearest other limb inwards and along, of both limits of the joint and of dry friction."""
LIMB_OUTPUTS = 2 * IMPULSES
"""Numbers that the decoder gives for a limb: impulses over the step, and their part in where it
ends, which follows from the first where the engine takes one Euler step."""
_ANGLE, _HEIGHT, _SPEED = 0.02, 0.005, 0.05
"""Scales below which rooms of joints (rad, m), heights (m) and speeds (m/s, rad/s) are seen
finely, as in `touch`."""
_NEAR, _ROOM = 0.002, 0.003
"""Distance (m) and room of a joint (rad, m) over which what constraints do fades out, from where
free motion would not pass them in this step: MuJoCo's constraints act from overlap on, so that
motion away from all of them is what is known of it."""
_FAR = 10.0  # m, further than limbs of one robot reach
_LEAST = 0.05
"""m/s: the least unit of an impulse; half of what gravity gives in a step of 10 ms."""
_OUT = 0.1
"""Share of an overlap that a unit of impulse undoes in a step: MuJoCo's contacts take some ten."""
_STIFF = 0.1
"""See `Contact.give`."""
_TINY = 1e-6


class Points(NamedTuple):
    """Where limbs may touch something, N of them for each limb.

    Attributes:
      gap: [B, P, N] distance, m. normal: [B, P, N, 3] away from what is touched.
      slopes: [B, P, N, P, 3] Jacobian of the point's velocity (relative, if the other moves).
      there: [B, P, N] 1 where it can touch at all. friction: [B, P, 1].
    """

    gap: Tensor
    normal: Tensor
    slopes: Tensor
    there: Tensor
    friction: Tensor


class Contact(NamedTuple):
    """`Points` in motion.

    Attributes:
      before, free: [B, P, N, 3] velocity now and after the step without constraints, m/s.
      after: [B, P, N] the gap that this velocity leads to, m.
      ways: [B, P, N, T, 3] along which it may slide.
      give: [B, P, N, 1 + T] inverse of the masses that impulses along the normal and these meet,
        1/kg; with a share of the others', so that what can hardly move is not pushed hard.
      near: [B, P, N] 1 at a touch, 0 far away. unit: [B, P, N] of speeds that impulses make, m/s.
    """

    points: Points
    before: Tensor
    free: Tensor
    after: Tensor
    ways: Tensor
    give: Tensor
    near: Tensor
    unit: Tensor


class Known(NamedTuple):
    """What is known of a step before a network says anything.

    Attributes:
      q, v: [B, P] after it, without constraints. inverse: [B, P, P] of the inertia matrix.
      motion: where limbs are before it. floor, limbs: contacts.
      room, free_room: [B, P, 2] to the lower and upper limit, before and after.
    """

    q: Tensor
    v: Tensor
    inverse: Tensor
    motion: Motion
    floor: Contact
    limbs: Contact
    room: Tensor
    free_room: Tensor


class Articulation(nn.Module):
    """Kinematics, known dynamics and features of robots made of limbs.

    Args:
      layout: an articulated one.
      config: of the network; nothing of it changes what is seen.
    """

    def __init__(self, layout: Layout, config: ModelConfig) -> None:
        super().__init__()
        self.layout, self.config = layout, config
        self.mechanics = Mechanics(layout)
        place = layout.part_columns.index
        self._index("seen", [place(name) for name in SEEN])
        self.register_buffer("up", torch.tensor([0.0, 0.0, 1.0]), persistent=False)
        level = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        self.register_buffer("level", level, persistent=False)
        names = ("gravity_x", "timestep", "control_timestep")
        self.gravity, self.fine_step, self.step = (layout.settings.index(name) for name in names)
        first = place(SHAPE[0])
        each = len(SHAPE) // CAPSULES
        starts = [first + number * each for number in range(CAPSULES)]
        self._index("ends", [s + 3 * end + i for s in starts for end in (0, 1) for i in range(3)])
        self._index("radii", [s + 6 for s in starts])
        self._index("alone", [s + 7 for s in starts])
        self._index("present", [s + 8 for s in starts])
        count = len(layout.parts)
        pairs = [(i, j) for i in range(count) for j in range(count)]
        self._index("one", [i for i, _ in pairs])
        self._index("other", [j for _, j in pairs])

    # -- what the network sees -------------------------------------------------------------------

    def attributes(self, context: Context) -> Tensor:
        """[B, P, D]: what conditions a limb's token."""
        assert context.parts is not None
        return context.parts.index_select(2, self.seen)

    def features(self, x: Entities, control: Tensor, context: Context) -> Tensor:
        """[B, P, F] of states under controls (see `known` and `seen_of`)."""
        return self.seen_of(x, self.known(x, control, context), context)

    def seen_of(self, x: Entities, known: Known, context: Context) -> Tensor:
        """[B, P, F]: the joint, the free motion, and what may be touched."""
        take = self.mechanics.column
        hinge, limited = take(context, "type_hinge"), take(context, "limited")
        fixed = x.q * (1.0 - take(context, "ignored"))
        own = torch.diagonal(known.inverse, dim1=1, dim2=2)
        dry = take(context, "frictionloss") * self._dt(context) * own
        rooms = [fine(room, _ANGLE) * limited[..., None] for room in (known.room, known.free_room)]
        passed = (known.room < 0).to(x.q.dtype) * limited[..., None]
        single = [
            *(fixed.sin() * hinge, fixed.cos() * hinge, fixed * (1.0 - hinge)),
            *(x.v, fine(x.v, _SPEED), known.v - x.v, fine(known.v, _SPEED), fine(dry, _SPEED)),
            (own + _TINY).log(),
        ]
        motion = known.motion
        parts = [
            torch.stack(single, dim=-1),
            *rooms,
            passed,
            motion.rot[..., 2, :],
            fine(motion.turning, _SPEED),
            *self._of_contact(known.floor, self._dt(context)),
            *self._of_contact(known.limbs, self._dt(context)),
            (known.limbs.points.normal * known.limbs.near[..., None]).flatten(2),
        ]
        return torch.cat(parts, dim=-1)

    def _of_contact(self, contact: Contact, dt: Tensor) -> list[Tensor]:
        points, near = contact.points, contact.near
        speeds = [
            (fine(v, _SPEED) * near[..., None]).flatten(2) for v in (contact.before, contact.free)
        ]
        give = (contact.give[..., 0] + _TINY).log() * points.there
        gap, after = points.gap.clamp(max=1.0), contact.after.clamp(max=1.0)
        heights = [gap, fine(gap, _HEIGHT), fine(after, _HEIGHT)]
        inside = (gap < 0).to(gap.dtype)
        leaves = fine((-gap).clamp(min=0) / dt[..., None], _SPEED)  # to be out of it in a step
        return [*heights, inside, leaves, near, give, *speeds]

    # -- what is known ---------------------------------------------------------------------------

    def known(self, x: Entities, control: Tensor, context: Context) -> Known:
        """Free motion over one step, and where constraints may act."""
        dt = self._dt(context)
        gravity = context.world[:, self.gravity : self.gravity + 3]
        fine_step = context.world[:, self.fine_step, None]
        free = self.mechanics.step(x.q, x.v, control, context, gravity, fine_step, dt)
        take = self.mechanics.column
        low, high = take(context, "low"), take(context, "high")
        now, later = (torch.stack([q - low, high - q], dim=-1) for q in (x.q, free.q))
        floor, limbs = self._floor(free.motion, context), self._limbs(free.motion, context)
        return Known(
            free.q,
            free.v,
            free.inverse,
            free.motion,
            self._moving(floor, self.level, x.v, free, dt),
            self._moving(limbs, None, x.v, free, dt),
            now,
            later,
        )

    def _dt(self, context: Context) -> Tensor:
        """[B, 1]: duration of a step, s."""
        return context.world[:, self.step, None]

    def _capsules(self, motion: Motion, context: Context) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Ends [B, P, C, 3] of the axes in the world, radii [B, P, C], whether the limb has them,
        [B, P, C], and whether they are another end than the one before."""
        assert context.parts is not None
        ends = context.parts.index_select(2, self.ends).unflatten(2, (ENDS, 3))
        placed = (motion.rot[:, :, None] * ends[..., None, :]).sum(-1) + motion.pos[:, :, None]
        radius, long, there = (
            context.parts.index_select(2, which) for which in (self.radii, self.alone, self.present)
        )
        twice = [part.repeat_interleave(2, dim=2) for part in (radius, there)]
        second = torch.stack([torch.ones_like(long), long], dim=-1).flatten(2)
        return placed, twice[0], twice[1], second

    def _floor(self, motion: Motion, context: Context) -> Points:
        """The lowest points at the ends of capsules over a level floor."""
        ends, radius, there, second = self._capsules(motion, context)
        take = self.mechanics.column
        up = self.up.expand(ends.shape)
        points = ends - up * radius[..., None]
        gap = points[..., 2] - take(context, "floor")[..., None]
        there = there * second * take(context, "floor_there")[..., None]
        gap = torch.where(there > 0, gap, torch.full_like(gap, _FAR))
        rows = motion.ancestors[:, :, None].expand(-1, -1, ENDS, -1)
        friction = take(context, "friction")[..., None]
        return Points(gap, up, along(motion, points, rows), there, friction)

    def _limbs(self, motion: Motion, context: Context) -> Points:
        """Of each limb the nearest point of another that it can touch."""
        ends, radius, there, _ = self._capsules(motion, context)
        count = len(self.layout.parts)
        ends = ends.unflatten(2, (CAPSULES, 2))  # [B, P, 2, 2, 3]
        radius, there = radius[:, :, ::2], there[:, :, ::2]  # [B, P, 2]
        one, other = ends.index_select(1, self.one), ends.index_select(1, self.other)
        shape = (-1, -1, CAPSULES, CAPSULES, 2, 3)
        a = one[:, :, :, None].expand(shape).flatten(2, 3).flatten(1, 2)
        b = other[:, :, None].expand(shape).flatten(2, 3).flatten(1, 2)
        share_a, share_b = closest(a, b)
        here, beyond = _between(a, share_a), _between(b, share_b)
        apart = here - beyond
        length = apart.square().sum(-1).add(1e-9).sqrt()
        normal = apart / length[..., None]
        pair = (radius.index_select(1, self.one), radius.index_select(1, self.other))
        thick = (pair[0][..., None] + pair[1][:, :, None]).flatten(1)
        may = self._may_touch(context).flatten(1)[..., None, None]
        both = (
            there.index_select(1, self.one)[..., None]
            * there.index_select(1, self.other)[:, :, None]
        )
        allowed = (may * both).flatten(1) > 0
        gap = torch.where(allowed, length - thick, torch.full_like(length, _FAR))
        surface = here - normal * pair[0][..., None].expand(both.shape).flatten(1)[..., None]
        rows = (count, count * CAPSULES**2)
        nearest = gap.unflatten(1, rows).argmin(-1, keepdim=True)  # [B, P, 1]
        gap = gap.unflatten(1, rows).gather(2, nearest)
        wide = nearest[..., None].expand(-1, -1, -1, 3)
        normal = normal.unflatten(1, rows).gather(2, wide)
        point = surface.unflatten(1, rows).gather(2, wide)
        whose = torch.div(nearest[..., 0], CAPSULES**2, rounding_mode="floor")
        theirs = motion.ancestors.gather(1, whose[..., None].expand(-1, -1, count))
        moved = motion.ancestors - theirs  # what both hang on moves neither against the other
        slopes = along(motion, point, moved[:, :, None])
        friction = self.mechanics.column(context, "friction")[..., None]
        return Points(gap, normal, slopes, (gap < _FAR).to(gap.dtype), friction)

    def _may_touch(self, context: Context) -> Tensor:
        """[B, P, P]: limbs that meet, of bodies that are not the same and not each other's parent."""
        take = self.mechanics.column
        meets, body, parent = (take(context, n) for n in ("meets", "body", "parent_body"))
        apart = (body[:, :, None] != body[:, None]) & (parent[:, :, None] != body[:, None])
        apart = apart & (body[:, :, None] != parent[:, None])
        return meets[:, :, None] * meets[:, None] * apart

    def _moving(
        self, points: Points, level: Tensor | None, v: Tensor, free: Free, dt: Tensor
    ) -> Contact:
        """Contacts that slide along the axes `level` [2, 3], or straight on without."""
        before, later = ((points.slopes * w[:, None, None, :, None]).sum(3) for w in (v, free.v))
        inward = (later * points.normal).sum(-1, keepdim=True)
        if level is None:
            along_it = _direction(later - inward * points.normal)[..., None, :]
        else:
            along_it = level.expand(*later.shape[:-1], 2, 3)
        axes = torch.cat([points.normal[..., None, :], along_it], dim=-2)
        slope = (points.slopes[..., None, :, :] * axes[..., None, :]).sum(-1)  # [B, P, N, T, P]
        moved = slope.flatten(1, 3) @ free.inverse  # rounding here only changes a unit
        give = (slope * moved.view_as(slope)).sum(-1)
        give = give + _STIFF * give.mean(-1, keepdim=True)
        speed = (later * points.normal).sum(-1)
        wait = dt[..., None]
        after = points.gap + wait * speed
        near = torch.exp(-torch.minimum(points.gap, after).clamp(min=0) / _NEAR)
        unit = _LEAST + (-speed).clamp(min=0) + _OUT * (-points.gap).clamp(min=0) / wait
        return Contact(points, before, later, after, along_it, give, near * points.there, unit)

    # -- what the network says -------------------------------------------------------------------

    def advance(self, x: Entities, known: Known, said: Tensor, context: Context) -> Entities:
        """The next state from the decoder's numbers [B, P, LIMB_OUTPUTS]."""
        dt = self._dt(context)
        count = (dt / context.world[:, self.fine_step, None]).round()
        spread = 0.5 if self.layout.runge_kutta else (count + 1.0) / (2.0 * count)
        within = torch.ones_like(dt) if self.layout.runge_kutta else (count > 1.5).to(dt.dtype)
        first, second = said.split(IMPULSES, dim=-1)
        change = applied(known.inverse, self._impulse(known, first, context))
        later = applied(known.inverse, self._moment(known, second, context))
        v = known.v + change
        q = known.q + dt * (spread * change + within * later)
        return x._replace(q=q, v=v)

    def _impulse(self, known: Known, said: Tensor, context: Context) -> Tensor:
        """[B, P]: generalised impulses; inwards at contacts and limits, within friction's bounds.

        A network that says nothing stops what moves in, and what slides as far as friction goes.
        """
        ends, limb, (low, high, dry) = _split(said)
        total = self._contact_impulse(known.floor, ends)
        total = total + self._contact_impulse(known.limbs, limb)
        own = torch.diagonal(known.inverse, dim1=1, dim2=2) + _TINY
        take, dt = self.mechanics.column, self._dt(context)
        fades = self._limit_fades(known, context)
        toward = torch.stack([-known.v, known.v], dim=-1)  # to the lower and the upper limit
        unit = _LEAST + toward.clamp(min=0) + _OUT * (-known.room).clamp(min=0) / dt[..., None]
        pushed = nn.functional.softplus(torch.stack([low, high], dim=-1)) * unit * fades
        total = total + (pushed[..., 0] - pushed[..., 1]) / own
        bound = take(context, "frictionloss") * dt
        return total + bound * torch.tanh((_LEAST * dry - known.v) / (bound * own + _TINY))

    def _contact_impulse(self, contact: Contact, said: Tensor) -> Tensor:
        """[B, P] of numbers [B, P, N, 1 + tangents]."""
        points = contact.points
        give = contact.give + _TINY
        size = nn.functional.softplus(said[..., 0]) * contact.unit * contact.near
        normal = size / give[..., 0]
        bound = (points.friction * normal)[..., None]
        speed = (contact.free[..., None, :] * contact.ways).sum(-1)
        wanted = (said[..., 1:] * contact.unit[..., None] - speed) / give[..., 1:]
        tangent = bound * torch.tanh(wanted / (bound + _TINY))
        force = normal[..., None] * points.normal + (tangent[..., None] * contact.ways).sum(-2)
        return (points.slopes * force[..., None, :]).sum((1, 2, 4))

    def _moment(self, known: Known, said: Tensor, context: Context) -> Tensor:
        """[B, P]: how impulses within the step move more, or less, than spread evenly over it."""
        ends, limb, (low, high, dry) = _split(said)
        total = self._plain(known.floor, ends) + self._plain(known.limbs, limb)
        own = torch.diagonal(known.inverse, dim1=1, dim2=2) + _TINY
        fades = self._limit_fades(known, context)
        total = total + _LEAST * (low * fades[..., 0] - high * fades[..., 1]) / own
        bound = self.mechanics.column(context, "frictionloss") * self._dt(context)
        return total + bound * torch.tanh(dry)

    def _plain(self, contact: Contact, said: Tensor) -> Tensor:
        points = contact.points
        axes = torch.cat([points.normal[..., None, :], contact.ways], dim=-2)
        size = (contact.unit * contact.near)[..., None] / (contact.give + _TINY)
        force = ((said * size)[..., None] * axes).sum(-2)
        return (points.slopes * force[..., None, :]).sum((1, 2, 4))

    def _limit_fades(self, known: Known, context: Context) -> Tensor:
        """[B, P, 2]: 1 at a limit, 0 far from it or without."""
        least = torch.minimum(known.room, known.free_room).clamp(min=0)
        return torch.exp(-least / _ROOM) * self.mechanics.column(context, "limited")[..., None]

    def units(self, context: Context) -> Tensor:
        """[B, P, 2] of `UNITS`."""
        return self.mechanics.columns(context, UNITS[0], len(UNITS))

    def _index(self, name: str, values: Sequence[int]) -> None:
        self.register_buffer(name, torch.tensor(values, dtype=torch.long), persistent=False)


def _split(said: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor, Tensor]]:
    """Numbers of the ends [B, P, C, 3], of the nearest limb [B, P, 1, 2], and of the joint."""
    ends, limb, joint = said.split((3 * ENDS, 2, 3), dim=-1)
    low, high, dry = joint.unbind(-1)
    return ends.unflatten(-1, (ENDS, 3)), limb[..., None, :], (low, high, dry)


def _direction(slide: Tensor) -> Tensor:
    """[..., 3] of length 1, or 0 where nothing slides."""
    return slide / slide.square().sum(-1, keepdim=True).add(_TINY).sqrt()


def _between(ends: Tensor, share: Tensor) -> Tensor:
    return ends[..., 0, :] + share * (ends[..., 1, :] - ends[..., 0, :])


def stopped(bias: Tensor) -> None:
    """Biases of a decoder's last layer [LIMB_OUTPUTS] with which contacts are inelastic at first:
    softplus of it is 1."""
    with torch.no_grad():
        bias.zero_()
        for place in (*range(0, 3 * ENDS, 3), 3 * ENDS, 3 * ENDS + 2, 3 * ENDS + 3):
            bias[place] = math.log(math.e - 1.0)


def silenced(last: nn.Linear) -> None:
    """A decoder's last layer that gives no impulses at contacts and limits, whatever it is given.

    What friction of its own a joint has still acts.
    """
    with torch.no_grad():
        last.weight.zero_()
        last.bias.zero_()
        for place in (*range(0, 3 * ENDS, 3), 3 * ENDS, 3 * ENDS + 2, 3 * ENDS + 3):
            last.bias[place] = _SILENT


_SILENT = -30.0
"""Its softplus is 1e-13."""
