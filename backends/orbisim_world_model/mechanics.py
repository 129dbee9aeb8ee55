"""Free motion of trees of hinges and slides in torch: kinematics, inertia, one step of an engine.

Everything about the bodies comes with the `Context`, so that worlds of a batch may hold different
robots. Products are multiplied and summed, since a GPU's matrix units may round to ten bits.

Shapes: B worlds, P joints, each with the body that it moves.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim_world_model.entities import Context
from orbisim_world_model.layout import Layout
from orbisim_world_model.rotation import exponential, product, rotate, to_matrix


class Motion(NamedTuple):
    """Bodies in the world frame.

    Attributes:
      pos, rot: [B, P, 3], [B, P, 3, 3] of bodies' frames. axis, anchor: [B, P, 3] of the joints.
      hinge: [B, P]. ancestors: [B, P, P], 1 where the second joint moves the first one's body.
      turning: [B, P, 3] angular velocity of the bodies.
    """

    pos: Tensor
    rot: Tensor
    axis: Tensor
    anchor: Tensor
    hinge: Tensor
    ancestors: Tensor
    turning: Tensor


class Free(NamedTuple):
    """A step without constraints: where it ends, the inverse inertia it began with, the motion."""

    q: Tensor
    v: Tensor
    inverse: Tensor
    motion: Motion


class Mechanics(nn.Module):
    """What a layout's columns say of bodies and motors.

    Args:
      layout: an articulated one.
    """

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self.names = {name: place for place, name in enumerate(layout.part_columns)}
        self.count = len(layout.parts)
        self.rounds = max(1, (self.count - 1).bit_length())
        self.runge_kutta, self.substeps = layout.runge_kutta, layout.substeps
        # buffers, so that nothing is copied from the host while a CUDA graph is recorded
        self.register_buffer("eye", torch.eye(self.count), persistent=False)
        self.register_buffer("unit", torch.tensor([1.0, 0.0, 0.0, 0.0]), persistent=False)

    def column(self, context: Context, name: str) -> Tensor:
        """[B, P] of one column."""
        assert context.parts is not None
        return context.parts[..., self.names[name]]

    def columns(self, context: Context, name: str, count: int) -> Tensor:
        """[B, P, count]: columns from a name on."""
        assert context.parts is not None
        first = self.names[name]
        return context.parts[..., first : first + count]

    # -- where bodies are ------------------------------------------------------------------------

    def motion(self, q: Tensor, v: Tensor, context: Context) -> Motion:
        """Of positions and velocities [B, P]; ignored positions are taken to be 0."""
        rot, pos, ancestors = self._placed(q * (1.0 - self.column(context, "ignored")), context)
        hinge = self.column(context, "type_hinge")
        axis = rotate(rot, self.columns(context, "axis_x", 3))
        anchor = pos + rotate(rot, self.columns(context, "anchor_x", 3))
        spin = axis * (v * hinge)[..., None]
        turning = (ancestors[..., None] * spin[:, None]).sum(2)
        return Motion(pos, rot, axis, anchor, hinge, ancestors, turning)

    def _placed(self, q: Tensor, context: Context) -> tuple[Tensor, Tensor, Tensor]:
        """Rotations [B, P, 3, 3], positions [B, P, 3], ancestors [B, P, P].

        Each body's pose in its parent's is multiplied by that of its ancestors, twice as many in
        each round.
        """
        hinge = self.column(context, "type_hinge")[..., None]
        moved = (q - self.column(context, "reference"))[..., None]
        axis, anchor = (self.columns(context, name, 3) for name in ("axis_x", "anchor_x"))
        quat = self.columns(context, "base_qw", 4)
        there = self.there(context)[..., None]
        lies = to_matrix(quat + (1.0 - there) * self.unit)
        spin = to_matrix(exponential(axis * moved * hinge))
        rot = product(lies, spin)
        shift = anchor - rotate(spin, anchor) + axis * moved * (1.0 - hinge)
        pos = self.columns(context, "base_x", 3) + rotate(lies, shift)
        size, count = len(q), self.count
        parent = self.column(context, "parent").round().long()
        parent = torch.where(parent < 0, count, parent)
        last = torch.full_like(parent[:, :1], count)
        ancestors = self.eye.to(q.dtype).expand(size, count, count)
        world = self.eye.new_zeros(1).to(q.dtype)
        eye3 = torch.eye(3, device=q.device, dtype=q.dtype).expand(size, 1, 3, 3)
        for _ in range(self.rounds):
            above = parent[..., None]
            base = torch.cat([pos, world.expand(size, 1, 3)], 1).gather(1, above.expand(-1, -1, 3))
            way = torch.cat([rot, eye3], 1).gather(1, above[..., None].expand(-1, -1, 3, 3))
            more = torch.cat([ancestors, world.expand(size, 1, count)], 1)
            ancestors = ancestors + more.gather(1, above.expand(-1, -1, count))
            pos, rot = base + rotate(way, pos), product(way, rot)
            parent = torch.cat([parent, last], dim=1).gather(1, parent)
        return rot, pos, ancestors

    def there(self, context: Context) -> Tensor:
        """[B, P]: 1 for joints, 0 for padding."""
        quat = self.columns(context, "base_qw", 4)
        return (quat.square().sum(-1) > 0.5).to(quat.dtype)

    # -- forces ----------------------------------------------------------------------------------

    def inertia(
        self, motion: Motion, v: Tensor, context: Context, gravity: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The inertia matrix [B, P, P], and the forces [B, P] that keep velocities constant.

        Newton's and Euler's equations of each body, projected onto the joints.
        """
        mass = self.column(context, "mass")
        centre = motion.pos + rotate(motion.rot, self.columns(context, "com_x", 3))
        linear = along(motion, centre[:, :, None], motion.ancestors[:, :, None])[:, :, 0]
        angular = motion.ancestors[..., None] * (motion.axis * motion.hinge[..., None])[:, None]
        tensor = self._tensors(motion, context)  # [B, P, 3, 3]
        heavy = (tensor[:, :, None] * angular[..., None, :]).sum(-1)  # [B, P, P, 3]
        matrix = (mass[..., None, None] * linear)[:, :, :, None] * linear[:, :, None]
        matrix = matrix + angular[:, :, :, None] * heavy[:, :, None]
        matrix = matrix.sum((1, 4))
        own = self.column(context, "armature") + 1.0 - self.there(context)
        matrix = matrix + torch.diag_embed(own)
        push, twist = self._drift(motion, v, centre, linear)
        push = mass[..., None] * (
            push - self.column(context, "heavy")[..., None] * gravity[:, None]
        )
        spin = rotate(tensor, motion.turning)
        twist = rotate(tensor, twist) + torch.linalg.cross(motion.turning, spin)
        force = (linear * push[:, :, None]).sum((1, 3)) + (angular * twist[:, :, None]).sum((1, 3))
        return matrix, force

    def _tensors(self, motion: Motion, context: Context) -> Tensor:
        """[B, P, 3, 3]: inertia about bodies' centres in the world frame."""
        six = self.columns(context, "inertia_xx", 6)
        order = [0, 3, 4, 3, 1, 5, 4, 5, 2]
        local = torch.stack([six[..., i] for i in order], dim=-1).unflatten(-1, (3, 3))
        return product(product(motion.rot, local), motion.rot.transpose(-1, -2))

    def _drift(
        self, motion: Motion, v: Tensor, centre: Tensor, linear: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Accelerations [B, P, 3] of centres and of rotation at constant joint velocities."""
        hinge = motion.hinge[..., None]
        speed = (linear * v[:, None, :, None]).sum(2)  # of centres
        arm = motion.anchor - centre
        pivot = speed + torch.linalg.cross(motion.turning, arm)
        turned = torch.linalg.cross(motion.turning, motion.axis)  # rate of the axes
        reach = centre[:, :, None] - motion.anchor[:, None]  # [B, bodies, joints, 3]
        shape = reach.shape
        swing = torch.linalg.cross(turned[:, None].expand(shape), reach)
        rate = speed[:, :, None] - pivot[:, None]
        swing = swing + torch.linalg.cross(motion.axis[:, None].expand(shape), rate)
        each = swing * hinge[:, None] + (turned * (1.0 - hinge))[:, None]
        weight = (motion.ancestors * v[:, None])[..., None]
        spin = (weight * (turned * hinge)[:, None]).sum(2)
        return (weight * each).sum(2), spin

    def force(
        self, q: Tensor, v: Tensor, control: Tensor, context: Context
    ) -> tuple[Tensor, Tensor]:
        """[B, P]: of motors, springs and dampers, and damping that is integrated implicitly."""
        take = self.column
        spring = take(context, "stiffness") * (take(context, "springref") - q)
        passive, implicit = spring - take(context, "damping") * v, take(context, "implicit")
        if not control.shape[1]:
            return passive, implicit
        number = take(context, "control").round().long()
        given = control.gather(1, number.clamp(min=0))
        given = given.maximum(take(context, "ctrl_low")).minimum(take(context, "ctrl_high"))
        gear = take(context, "gear") * (number >= 0)
        made = take(context, "gain") * given + take(context, "bias_0")
        made = made + gear * (take(context, "bias_1") * q + take(context, "bias_2") * v)
        low, high = take(context, "force_low"), take(context, "force_high")
        free = (made > low) & (made < high)  # what is cut off does not damp
        damped = gear.square() * take(context, "bias_2") * take(context, "motor_implicit") * free
        return passive + gear * made.maximum(low).minimum(high), implicit - damped

    # -- a step ----------------------------------------------------------------------------------

    def step(
        self,
        q: Tensor,
        v: Tensor,
        control: Tensor,
        context: Context,
        gravity: Tensor,
        fine: Tensor,
        step: Tensor,
    ) -> Free:
        """A step [B, 1] s long, as MuJoCo takes it in parts of `fine` [B, 1] s.

        Euler's method with implicit damping, or Runge and Kutta's of fourth order.
        """
        if self.runge_kutta:
            return self._fourth_order(q, v, control, context, gravity, step)
        count = (step / fine).round()
        motion = first = None
        for number in range(self.substeps):
            now = self.motion(q, v, context)
            matrix, drift = self.inertia(now, v, context, gravity)
            force, implicit = self.force(q, v, control, context)
            back = inverse(matrix + torch.diag_embed(fine * implicit))
            if motion is None:
                motion, first = now, back
            rate = applied(back, force - drift)
            part = fine * (number < count)
            v = v + part * rate
            q = q + part * v
        assert motion is not None and first is not None
        return Free(q, v, first, motion)

    def _fourth_order(
        self, q: Tensor, v: Tensor, control: Tensor, context: Context, gravity: Tensor, step: Tensor
    ) -> Free:
        motion = self.motion(q, v, context)
        matrix, drift = self.inertia(motion, v, context, gravity)
        first = inverse(matrix)
        rate = applied(first, self.force(q, v, control, context)[0] - drift)
        speeds, rates = [v], [rate]
        for share in (0.5, 0.5, 1.0):
            at, fast = q + share * step * speeds[-1], v + share * step * rates[-1]
            there = self.motion(at, fast, context)
            matrix, drift = self.inertia(there, fast, context, gravity)
            force = self.force(at, fast, control, context)[0] - drift
            speeds.append(fast)
            rates.append(applied(inverse(matrix), force))
        weights = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
        q = q + step * sum(w * s for w, s in zip(weights, speeds, strict=True))
        v = v + step * sum(w * r for w, r in zip(weights, rates, strict=True))
        return Free(q, v, first, motion)


def along(motion: Motion, points: Tensor, rows: Tensor) -> Tensor:
    """Jacobians [B, P, N, P, 3] of the velocities of points [B, P, N, 3].

    Args:
      rows: [B, P, N, P] by how much each joint moves the point, 0 or 1.
    """
    reach = points[..., None, :] - motion.anchor[:, None, None]
    axis = motion.axis[:, None, None].expand(reach.shape)
    hinge = motion.hinge[:, None, None, :, None]
    return rows[..., None] * (torch.linalg.cross(axis, reach) * hinge + axis * (1.0 - hinge))


def applied(matrix: Tensor, vector: Tensor) -> Tensor:
    """[B, P]: matrices [B, P, P] times vectors [B, P]."""
    return (matrix * vector[:, None]).sum(-1)


def inverse(matrix: Tensor) -> Tensor:
    """Of symmetric positive definite matrices [B, P, P], by Gauss and Jordan's elimination."""
    size = matrix.shape[1]
    eye = torch.eye(size, device=matrix.device, dtype=matrix.dtype)
    both = torch.cat([matrix, eye.expand(matrix.shape)], dim=2)
    for k in range(size):
        row = both[:, k : k + 1] / both[:, k : k + 1, k : k + 1]
        both = both - (both[:, :, k : k + 1] - eye[:, k : k + 1]) * row
    return both[:, :, size:]
