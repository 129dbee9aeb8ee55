"""The losses: equations 3_losses and the state loss of appendix B.1."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.rotation import (
    conjugate,
    geodesic_distance,
    logarithm,
    multiply,
    quaternion_distance,
)


def transition_loss(predicted: Tensor, latent: Tensor, mask: Tensor | None = None) -> Tensor:
    """Equation 3_losses, L_tra = ||zhat_t - sg(z_t)||^2, mean over entries.

    Args:
      predicted, latent: [B, K, width] or [B, width].
      mask: [B, K], 0 for tokens that do not count.
    """
    return _mean((predicted.float() - latent.float().detach()).square(), mask)


def encoding_loss(predicted: Tensor, latent: Tensor, mask: Tensor | None = None) -> Tensor:
    """Equation 3_losses, L_enc = ||z_t - sg(zhat_t)||^2, mean over entries."""
    return _mean((latent.float() - predicted.float().detach()).square(), mask)


def _mean(values: Tensor, mask: Tensor | None) -> Tensor:
    if mask is None:
        return values.mean()
    return (values.mean(-1) * mask).sum() / mask.sum().clamp_min(1.0)


def state_loss(predicted: Entities, x: Entities, mask: Tensor, layout: Layout) -> Tensor:
    """Equation 3_losses, L_dec = L_state = L_robot + L_object, in SI units; [B].

    The trajectory error (TrajErr) of an evaluation is the same number.
    """
    return robot_loss(predicted, x, layout) + object_loss(predicted, x, mask)


def robot_loss(predicted: Entities, x: Entities, layout: Layout) -> Tensor:
    """L_robot [B]: Smooth-L1 on the hand's position and velocity, geodesic distance on SO(3).

    A robot without a hand is measured by its joint coordinates, with Smooth-L1.
    """
    if layout.hand:
        return (
            smooth(predicted.hand_pos, x.hand_pos)
            + smooth(predicted.hand_vel, x.hand_vel)
            + geodesic_distance(predicted.hand_rot, x.hand_rot)
        )
    if layout.has_robot:
        return smooth(predicted.q, x.q) + smooth(predicted.v, x.v)
    return x.q.new_zeros(len(x.q))


def object_loss(predicted: Entities, x: Entities, mask: Tensor) -> Tensor:
    """L_object [B]: Smooth-L1 on position and velocity, normalised quaternion distance.

    Averaged over the objects that there are.
    """
    if not mask.shape[1]:
        return x.pos.new_zeros(len(x.pos))
    each = smooth(predicted.pos, x.pos) + smooth(predicted.vel, x.vel)
    each = each + quaternion_distance(predicted.quat, x.quat)  # [B, N]
    return (each * mask).sum(1) / mask.sum(1).clamp_min(1.0)


def smooth(a: Tensor, b: Tensor) -> Tensor:
    """Smooth-L1 distance, mean over the last axis."""
    return smooth_l1_loss(a, b, reduction="none").mean(-1)


_FLOORS = [1e-5, 1e-4, 1e-4, 1e-3]
"""Least scales of position (m), rotation (rad), velocity (m/s) and angular velocity (rad/s)."""


_PART_FLOORS = [1e-4, 1e-3, 1e-5, 1e-4]
"""... of the joints of parts: rad, rad/s, m, m/s."""


_LEAST_UNIT = 1e-6
"""Of limbs' units: padding has none, and counts for nothing."""


class Scales(NamedTuple):
    """The typical change over one step, by which errors are divided.

    Attributes:
      q, v, act: [J], [J], [A]. hand: [4] of position, rotation, velocity, angular velocity.
      objects: [4] of position, rotation, velocity, angular velocity.
      parts: [4] of position and velocity of hinges, then of slides; empty without parts.
    """

    q: Tensor
    v: Tensor
    act: Tensor
    hand: Tensor
    objects: Tensor
    parts: Tensor


def scaled_state_loss(
    predicted: Entities,
    x: Entities,
    context: Context,
    layout: Layout,
    scales: Scales,
    beta: float = 1.0,
    extended: bool = True,
) -> Tensor:
    """L_state [B], each error in units of its change over one step.

    Smooth-L1 throughout; rotations by the rotation vector between them. Of the extended state
    angular velocities, joint coordinates and activations beside what the paper has; of the paper's
    state (`extended=False`) its own entries alone, the hand's velocity among them. Errors below
    `beta` count quadratically. Parts of mechanisms are averaged like objects.
    """
    mask, own = context.mask, list(layout.robot_joints)
    assert mask is not None

    def near(a: Tensor, b: Tensor) -> Tensor:
        return smooth_l1_loss(a, b, reduction="none", beta=beta).mean(-1)

    total = x.pos.new_zeros(len(x.pos))
    if layout.has_robot and extended:
        q, v = scales.q, scales.v
        if layout.parts:
            total = total + _part_loss(predicted, x, context, layout, scales.parts, beta)
            q, v = q[own], v[own]
            predicted, x = (s._replace(q=s.q[:, own], v=s.v[:, own]) for s in (predicted, x))
        if own:
            total = total + near(predicted.q / q, x.q / q)
            total = total + near(predicted.v / v, x.v / v)
        if layout.na:
            total = total + near(predicted.act / scales.act, x.act / scales.act)
    if layout.hand:
        pos, rot, vel, _ = scales.hand
        total = total + near(predicted.hand_pos / pos, x.hand_pos / pos)
        if not extended:
            total = total + near(predicted.hand_vel / vel, x.hand_vel / vel)
        total = total + geodesic_distance(predicted.hand_rot, x.hand_rot).div(rot).clamp(max=10.0)
    if mask.shape[1]:
        pos, rot, vel, ang = scales.objects
        turn = logarithm(multiply(predicted.quat, conjugate(x.quat)))
        each = near(predicted.pos / pos, x.pos / pos) + near(predicted.vel / vel, x.vel / vel)
        each = each + near(turn / rot, torch.zeros_like(turn))
        if extended:
            each = each + near(predicted.ang / ang, x.ang / ang)
        total = total + (each * mask).sum(1) / mask.sum(1).clamp_min(1.0)
    return total


def _part_loss(
    predicted: Entities, x: Entities, context: Context, layout: Layout, scales: Tensor, beta: float
) -> Tensor:
    """[B]: of positions and velocities of the parts' joints, in units of their type's scale."""
    parts = list(layout.parts)
    scale = _by_type(scales, context, layout)  # [B, P, 2]
    given, found = (torch.stack([s.q[:, parts], s.v[:, parts]], dim=-1) for s in (x, predicted))
    each = smooth_l1_loss(found / scale, given / scale, reduction="none", beta=beta).sum(-1)
    return _averaged(each, context.part_mask)


def _by_type(scales: Tensor, context: Context, layout: Layout) -> Tensor:
    """[B, P, 2]: of [4], the numbers of hinges or of slides; limbs have their own."""
    assert context.parts is not None
    if layout.articulated:
        first = layout.part_columns.index("unit_q")
        return context.parts[..., first : first + 2].clamp_min(_LEAST_UNIT)
    hinge = context.parts[..., layout.part_columns.index("type_hinge"), None]
    return hinge * scales[:2] + (1.0 - hinge) * scales[2:]


def _averaged(each: Tensor, mask: Tensor | None) -> Tensor:
    """[B] of [B, P]: over the parts that there are."""
    if mask is None:
        return each.mean(1)
    return (each * mask).sum(1) / mask.sum(1).clamp_min(1.0)


def measure_scales(x: Entities, after: Entities, context: Context, layout: Layout) -> Scales:
    """Root mean square change over one step, from transitions of the training data."""
    mask = context.mask
    assert mask is not None

    def rms(change: Tensor, keep: Tensor | None = None) -> Tensor:
        rows = change if keep is None else change[keep > 0]
        return rows.square().mean().sqrt().clamp_min(1e-6)

    def each(change: Tensor) -> Tensor:
        return change.square().mean(0).sqrt().clamp_min(1e-6)

    hand = torch.ones(4, device=x.pos.device)
    if layout.hand:
        hand[0] = rms(after.hand_pos - x.hand_pos)
        hand[1] = rms(geodesic_distance(after.hand_rot, x.hand_rot))
        hand[2] = rms(after.hand_vel - x.hand_vel)
        hand[3] = rms(after.hand_ang - x.hand_ang)
    objects = torch.ones(4, device=x.pos.device)
    if mask.shape[1]:
        turn = logarithm(multiply(after.quat, conjugate(x.quat)))
        changes = (after.pos - x.pos, turn, after.vel - x.vel, after.ang - x.ang)
        objects = torch.stack([rms(change, mask) for change in changes])
    floors = torch.tensor(_FLOORS, device=x.pos.device)
    hand, objects = torch.maximum(hand, floors), torch.maximum(objects, floors)
    joints = each(after.q - x.q), each(after.v - x.v), each(after.act - x.act)
    return Scales(*joints, hand, objects, _part_scales(x, after, context, layout))


def _part_scales(x: Entities, after: Entities, context: Context, layout: Layout) -> Tensor:
    """[4] of `Scales.parts`."""
    if not layout.parts:
        return x.q.new_zeros(0)
    assert context.parts is not None and context.part_mask is not None
    parts = list(layout.parts)
    hinge = context.parts[..., layout.part_columns.index("type_hinge")] > 0.5
    found = []
    for kind in (hinge, ~hinge):
        kept = kind & (context.part_mask > 0)
        for change in (after.q - x.q, after.v - x.v):
            rows = change[:, parts][kept]
            found.append(rows.square().mean().sqrt() if len(rows) else rows.new_ones(()))
    return torch.stack(found).maximum(torch.tensor(_PART_FLOORS, device=x.q.device))
