"""PhyInf: density of each object and friction of the table from a window of states."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from orbisim_world_model.rotation import conjugate, logarithm, multiply
from torch import Tensor, nn

FRAMES = 64
"""Of a window; the paper's."""
FEWEST = 12
"""Frames in which an object must be known, or nothing is said of a window."""
NORMAL = 1.959964
"""Standard deviations on either side of the mean that 95 % of a normal distribution lie within."""
_WIDTH, _KERNEL = 64, 5
_DILATIONS = (1, 2, 4)
"""Of the convolutions over time: a reading knows 15 frames on either side, a slide and what is
before and after it."""
_DROPOUT = 0.05
"""Some thousand episodes are seen hundreds of times each."""
_FALL = 9.81 * 0.05**2
"""m: by how much a frame's step changes under gravity, frames 0.05 s apart. A body that slides on a
level table with nothing beside it loses the friction coefficient times this in each frame."""
_SOFT = 0.0005
"""m: what goes less far in two frames has hardly a direction."""
_PLACE, _STEP, _CHANGE, _TURN = 0.1, 0.01, 0.005, 0.1
"""Units of inputs: m between entities, m a frame, m a frame and frame, rad a frame."""
_HALF, _SMOOTH = 0.025, 0.4
"""Units of half sizes, m, and of an object's own friction."""
_EDGE = 0.02
"""Share of the range of logarithms next to its ends that a reading begins away from: a sigmoid has
no slope there."""
_LEAST = 0.01
"""Of a spread of a logarithm: surer than a hundredth no learned model is."""
_BLIND = -7.0
"""Before training a frame's reading weighs 0.001 of the prior: those of a window are no more than
0.1 of it, and each has a slope."""
_INPUTS = 56
"""Numbers of a frame of an object (see `_inputs`)."""


class Window(NamedTuple):
    """States as they were seen; B windows of T frames, N objects.

    Attributes:
      hand_pos: [B, T, 3], m. hand_rot: [B, T, 3, 3]. pos: [B, T, N, 3], m.
      quat: [B, T, N, 4]. What is not known has any finite value (a quaternion of length 1).
      hand_known: [B, T] and known: [B, T, N], 1 where a frame shows it, else 0.
      half: [B, N, 3] half sizes, m. friction: [B, N] of the objects' own surfaces.
      present: [B, N], 1 where there is an object, 0 where there is padding.
    """

    hand_pos: Tensor
    hand_rot: Tensor
    pos: Tensor
    quat: Tensor
    hand_known: Tensor
    known: Tensor
    half: Tensor
    friction: Tensor
    present: Tensor


class Posterior(NamedTuple):
    """Normal distributions of logarithms; the first is the table's friction, then N densities.

    Attributes:
      mean, spread: [B, 1 + N] and standard deviations.
    """

    mean: Tensor
    spread: Tensor


class PhysicsInference(nn.Module):
    """PhyInf (paper, section 3.4, appendix B.3): what a window of states says of what is unseen.

    Each frame of each object is a reading of the table's friction and of the object's density: a
    value and a weight. The friction's value begins at the object's deceleration along its motion in
    units of gravity, which is the friction where it slides freely; convolutions over time, alike
    for all objects, correct it and say what it weighs, from what is seen in the frame of its motion
    (of the object, the hand, and the nearest other object). The answer is the product of the prior
    and all readings, normal distributions: where none weighs anything it is the prior. Objects have
    no order, windows no origin and no direction.

    Buffers, taken from the training data (`know`) and from held-out windows: `low`, `high` [2]
    logarithms of the least and largest friction and density that were drawn, `middle` and `width`
    [2] mean and standard deviation of these logarithms, `widen` [2] factors on spreads.
    """

    low: Tensor
    high: Tensor
    middle: Tensor
    width: Tensor
    widen: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.into = nn.Linear(_INPUTS, _WIDTH)
        self.layers = nn.ModuleList(_Over(dilation) for dilation in _DILATIONS)
        self.head = nn.Linear(_WIDTH, 4)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        for name, value in (
            ("low", torch.zeros(2)),
            ("high", torch.ones(2)),
            ("middle", torch.full((2,), 0.5)),
            ("width", torch.full((2,), 0.3)),
            ("widen", torch.ones(2)),
        ):
            self.register_buffer(name, value)

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def know(self, friction: Tensor, density: Tensor) -> None:
        """Takes the prior from what was drawn, friction [E] and density [M]."""
        for number, values in enumerate((friction, density)):
            logs = values.log()
            self.low[number], self.high[number] = logs.min(), logs.max()
            self.middle[number], self.width[number] = logs.mean(), logs.std()

    @property
    def prior(self) -> Tensor:
        """[2, 2]: mean and standard deviation of the logarithms of friction and density."""
        return torch.stack([self.middle, self.width], dim=1)

    def forward(self, window: Window) -> Posterior:
        """What windows of `FRAMES` frames say; spreads are not yet widened (see `said`)."""
        x, slowing, shown = _inputs(window)
        z = self.into(x.flatten(0, 1)).transpose(1, 2)
        for layer in self.layers:
            z = layer(z)
        raw = self.head(z.transpose(1, 2)).unflatten(0, shown.shape[:2]).float()  # [B, N, T, 4]
        low, high, width = self.low, self.high, self.width
        table = (slowing.clamp_min(1e-3).log() - low[0]) / (high[0] - low[0])
        plain = (self.middle[1] - low[1]) / (high[1] - low[1])
        begin = torch.stack([table, plain.expand_as(table)], dim=-1)
        begin = begin.clamp(_EDGE, 1.0 - _EDGE).logit()
        value = low + (high - low) * (begin + raw[..., :2]).sigmoid()
        weight = nn.functional.softplus(_BLIND + raw[..., 2:]) * shown[..., None]
        # of the density an object's own readings, of the friction all of them
        said, sure = (value * weight).sum(2), weight.sum(2)  # [B, N, 2]
        said = torch.cat([said[..., 0].sum(1, keepdim=True), said[..., 1]], dim=1)
        sure = torch.cat([sure[..., 0].sum(1, keepdim=True), sure[..., 1]], dim=1)
        kind = self.kinds(shown.shape[1])
        mean = (self.middle[kind] + said) / (1.0 + sure)
        return Posterior(mean, (width[kind].square() / (1.0 + sure) + _LEAST**2).sqrt())

    def said(self, window: Window) -> Posterior:
        """`forward` with spreads as held-out windows have them, and never wider than the prior."""
        found = self(window)
        kind = self.kinds(found.mean.shape[1] - 1)
        prior = self.prior[kind]
        spread = (found.spread * self.widen[kind]).minimum(prior[:, 1])
        # of an object that hardly any frame shows nothing is said
        enough = window.known.sum(1) >= FEWEST
        shown = torch.cat([enough.any(1, keepdim=True), enough], dim=1)
        return Posterior(
            torch.where(shown, found.mean, prior[:, 0]), torch.where(shown, spread, prior[:, 1])
        )

    def kinds(self, objects: int) -> Tensor:
        """[1 + N] rows of the buffers: friction, then densities."""
        return torch.tensor([0, *([1] * objects)], device=self.low.device)


class _Over(nn.Module):
    """A convolution over time of [B, W, T], added to what comes in."""

    def __init__(self, dilation: int) -> None:
        super().__init__()
        around = dilation * (_KERNEL // 2)
        self.norm = nn.GroupNorm(1, _WIDTH)
        self.over = nn.Conv1d(_WIDTH, _WIDTH, _KERNEL, padding=around, dilation=dilation)
        self.out = nn.Conv1d(_WIDTH, _WIDTH, 1)
        self.drop = nn.Dropout(_DROPOUT)

    def forward(self, x: Tensor) -> Tensor:
        z = nn.functional.silu(self.over(nn.functional.silu(self.norm(x))))
        return x + self.out(self.drop(z))


def _steps(x: Tensor, known: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of x [B, T, ..., 3]: the step to each frame, the one from it, where both are known.

    0 where one of the two frames is not known, or is none of the window.
    """
    both = known[:, 1:] * known[:, :-1]
    step = (x[:, 1:] - x[:, :-1]) * both[..., None]
    none, never = torch.zeros_like(step[:, :1]), torch.zeros_like(both[:, :1])
    to, of = torch.cat([none, step], dim=1), torch.cat([step, none], dim=1)
    return to, of, torch.cat([never, both], dim=1) * torch.cat([both, never], dim=1)


def _inputs(window: Window) -> tuple[Tensor, Tensor, Tensor]:
    """[B, N, T, F]: what is seen of each object, in the frame of its motion.

    And [B, N, T] each: its deceleration along its motion in units of gravity, and 1 where it is
    seen in a frame and its neighbours.
    """
    pos, quat = window.pos, window.quat
    known = window.known * window.present[:, None]
    to, of, shown = _steps(pos, known)
    along = (to + of) * torch.tensor([1.0, 1.0, 0.0], device=pos.device)
    along = along / (along.norm(dim=-1, keepdim=True) + _SOFT)
    across = torch.stack([-along[..., 1], along[..., 0], along[..., 2]], dim=-1)

    def turned(x: Tensor) -> Tensor:
        """[B, T, N, 3]: along the motion, across it, upwards."""
        return torch.stack([(x * along).sum(-1), (x * across).sum(-1), x[..., 2]], dim=-1)

    change = turned(of - to) * shown[..., None]
    slowing = -change[..., 0] / _FALL
    hand_known = (window.hand_known[..., None] * known)[..., None]
    hand_to, hand_of, _ = _steps(window.hand_pos, window.hand_known)
    hand = turned(window.hand_pos[:, :, None] - pos) * hand_known
    axes = (window.hand_rot[..., i][:, :, None].expand_as(pos) for i in (0, 1))
    faces = torch.cat([turned(axis)[..., :2] for axis in axes], dim=-1)
    other, other_known = _nearest(pos, known)

    def of_other(x: Tensor) -> Tensor:
        return torch.gather(x, 2, other[..., None].expand(-1, -1, -1, 3)) * other_known[..., None]

    beside = turned(of_other(pos) - pos * other_known[..., None])
    radius = window.half.amax(-1)[:, None].expand(known.shape)
    apart = beside[..., :2].norm(dim=-1) - radius - torch.gather(radius, 2, other)
    turn = logarithm(multiply(quat[:, 1:], conjugate(quat[:, :-1])))
    turn = torch.cat([torch.zeros_like(turn[:, :1]), turn], dim=1) * shown[..., None]
    bottom = pos[..., 2:] - window.half[:, None, :, 2:]  # above the lowest of the window
    lowest = torch.where(known[..., None] > 0, bottom, torch.inf).amin((1, 2), keepdim=True)
    lowest = torch.where(torch.isfinite(lowest), lowest, torch.zeros_like(lowest))
    still = torch.cat([window.half / _HALF, window.friction[..., None] / _SMOOTH], dim=-1)
    steps = [turned(to), turned(of)]
    hand_steps = [turned(x[:, :, None].expand_as(pos)) * hand_known for x in (hand_to, hand_of)]
    other_steps = [turned(of_other(to)), turned(of_other(of))]
    x = torch.cat(
        [
            *(v / _STEP for v in (*steps, *hand_steps, *other_steps)),
            *(_fine(v[..., :2], _STEP) for v in steps),
            change / _CHANGE,
            _fine(change, _CHANGE),
            slowing[..., None].clamp(-2.0, 2.0),
            hand / _PLACE,
            faces * hand_known,
            beside / _PLACE,
            _fine(apart * other_known, _PLACE)[..., None],
            turned(turn) / _TURN,
            _double(quat, along),
            known[..., None] * (bottom - lowest) / _PLACE,
            still[:, None].expand(-1, pos.shape[1], -1, -1),
            known[..., None],
            shown[..., None],
            hand_known,
            other_known[..., None],
        ],
        dim=-1,
    )
    return x.transpose(1, 2), slowing.transpose(1, 2), shown.transpose(1, 2)


def _nearest(pos: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """[B, T, N] each: which other object that is known is nearest, and whether there is one."""
    far = torch.cdist(pos, pos)
    hidden = 1.0 - known[:, :, None] * known[..., None]
    far = far + 1e3 * (hidden + torch.eye(pos.shape[2], device=pos.device))
    near, other = far.min(-1)
    return other, (near < 1e3).to(pos.dtype)


def _fine(change: Tensor, unit: float) -> Tensor:
    """Small changes spread out, large ones drawn together: what rests is told from what creeps."""
    return torch.asinh(change / (0.05 * unit)) / 3.0


def _double(quat: Tensor, along: Tensor) -> Tensor:
    """[..., 4]: which way the object's first axis points as seen along its motion.

    As cosine and sine of twice the angle and of four times: a box looks the same from behind, a
    cube from each side. 0 for an axis that stands upright and where nothing moves.
    """
    w, x, y, z = quat.unbind(-1)
    axis = torch.complex(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z))
    angle = axis * torch.complex(along[..., 0], along[..., 1]).conj()
    double, fourfold = angle.square(), angle.square().square()
    return torch.stack([double.real, double.imag, fourfold.real, fourfold.imag], dim=-1)


def log_likelihood(found: Posterior, true: Tensor, mask: Tensor) -> Tensor:
    """[B]: of the true logarithms [B, 1 + N], where `mask` [B, 1 + N] has 1."""
    each = -0.5 * ((true - found.mean) / found.spread).square() - found.spread.log()
    return ((each - 0.5 * math.log(2.0 * math.pi)) * mask).sum(1)


def divergence(found: Posterior, prior: Tensor, mask: Tensor) -> Tensor:
    """[B]: Kullback-Leibler divergence from the prior, rows [1 + N, 2] of mean and deviation."""
    ratio = found.spread / prior[:, 1]
    away = (found.mean - prior[:, 0]) / prior[:, 1]
    return ((0.5 * (ratio.square() + away.square() - 1.0) - ratio.log()) * mask).sum(1)
