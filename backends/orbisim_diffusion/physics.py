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
_WIDTH, _HEADS, _LAYERS = 96, 4, 4
_DROPOUT = 0.1
"""Some thousand episodes are seen hundreds of times each."""
_STRIDES = 2
"""Convolutions that halve the number of times: 64 frames are 16 tokens of each entity."""
_PLACE, _STEP, _CHANGE, _TURN = 0.1, 0.01, 0.005, 0.1
"""Units of inputs: m between entities, m a frame, m a frame and frame, rad a frame. A cube that
slides on friction 0.4 loses 10 mm a frame in every frame of 0.05 s."""
_HALF, _SMOOTH = 0.025, 0.4
"""Units of half sizes, m, and of an object's own friction."""
_LEAST = 0.01
"""Of a spread of a logarithm: surer than a hundredth no learned model is."""
_BLIND = 2.0
"""Of an untrained network's spread: 0.88 of the prior's."""
_OBJECT, _ROBOT = 34, 15
"""Numbers of a frame of an object, of the hand (see `_objects`, `_hand`)."""


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

    Each entity's frames become few tokens by convolutions over time, alike for all objects; a
    transformer looks at the tokens of hand and objects together; each object's tokens answer for
    its density, all tokens together for the friction. Objects have no order, windows no origin.

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
        self.objects, self.hand = _track(_OBJECT), _track(_ROBOT)
        times = FRAMES // 2**_STRIDES
        self.time = nn.Parameter(0.02 * torch.randn(times, _WIDTH))
        self.kind = nn.Parameter(0.02 * torch.randn(2, _WIDTH))
        self.layers = nn.ModuleList(
            nn.TransformerEncoderLayer(
                _WIDTH, _HEADS, 4 * _WIDTH, _DROPOUT, "gelu", batch_first=True, norm_first=True
            )
            for _ in range(_LAYERS)
        )
        self.density, self.friction = _head(2 * _WIDTH), _head(3 * _WIDTH)
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
        present = window.present
        count, objects = present.shape
        tracks = self.objects(_objects(window).flatten(0, 1)).unflatten(0, (count, objects))
        hand = self.hand(_hand(window))[:, None]
        tokens = torch.cat([hand + self.kind[0], tracks + self.kind[1]], dim=1) + self.time
        entities, times = tokens.shape[1:3]
        there = torch.cat([torch.ones_like(present[:, :1]), present], dim=1)
        absent = (there < 0.5)[:, :, None].expand(-1, -1, times).flatten(1)
        z = tokens.flatten(1, 2)
        for layer in self.layers:
            z = layer(z, src_key_padding_mask=absent)
        z = z.unflatten(1, (entities, times)).float()
        pooled = torch.cat([z.mean(2), z.amax(2)], dim=-1)  # [B, 1 + N, 2 W]
        each = present[..., None]
        mean = (z[:, 1:].mean(2) * each).sum(1) / each.sum(1).clamp_min(1.0)
        largest = (z[:, 1:].amax(2) - 1e4 * (1.0 - each)).amax(1)
        table = self.friction(torch.cat([mean, largest, z[:, 0].mean(1)], dim=-1))
        return self._distribution(table, self.density(pooled[:, 1:]))

    def _distribution(self, table: Tensor, objects: Tensor) -> Posterior:
        """From answers [B, 2] and [B, N, 2]: means within what was drawn, spreads up to its own.

        Mean and spread are separate: a mean that is as far from the prior's as the spread is
        narrower than its own (the posterior of a prior and one reading) stays where it begins,
        since neither has a slope while the other one says nothing.
        """
        raw = torch.cat([table[:, None], objects], dim=1)
        kind = self.kinds(objects.shape[1])
        low, high, middle, width = (x[kind] for x in (self.low, self.high, self.middle, self.width))
        begin = ((middle - low) / (high - low)).clamp(0.01, 0.99).logit()
        mean = low + (high - low) * (begin + raw[..., 0]).sigmoid()
        spread = _LEAST + (width - _LEAST) * (_BLIND + raw[..., 1]).sigmoid()
        return Posterior(mean, spread)

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


def _track(inputs: int) -> nn.Sequential:
    """From frames [B, T, F] to tokens [B, T / 4, W]."""
    parts: list[nn.Module] = [nn.Linear(inputs, _WIDTH), _Transposed(), nn.SiLU()]
    for _ in range(_STRIDES):
        parts += [nn.Conv1d(_WIDTH, _WIDTH, 5, stride=2, padding=2), nn.SiLU()]
    return nn.Sequential(*parts, _Transposed())


class _Transposed(nn.Module):
    """Swaps the last two axes."""

    def forward(self, x: Tensor) -> Tensor:
        return x.transpose(1, 2)


def _head(inputs: int) -> nn.Sequential:
    """An untrained one answers 0: the prior."""
    last = nn.Linear(_WIDTH, 2)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.LayerNorm(inputs), nn.Linear(inputs, _WIDTH), nn.SiLU(), last)


def _origin(window: Window) -> Tensor:
    """[B, 1, 1, 3] where a window is looked at from: the middle of what the objects pass."""
    weight = (window.known * window.present[:, None])[..., None]
    total = weight.sum((1, 2)).clamp_min(1.0)
    return ((window.pos * weight).sum((1, 2)) / total)[:, None, None]


def _changes(x: Tensor, known: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """First and second differences over time [B, T, ..., 3], and whether both frames are known."""
    both = known[:, 1:] * known[:, :-1]
    first = (x[:, 1:] - x[:, :-1]) * both[..., None]
    both = torch.cat([torch.zeros_like(both[:, :1]), both], dim=1)
    first = torch.cat([torch.zeros_like(first[:, :1]), first], dim=1)
    three = both[:, 1:] * both[:, :-1]
    second = (first[:, 1:] - first[:, :-1]) * three[..., None]
    return first, torch.cat([torch.zeros_like(second[:, :1]), second], dim=1), both


def _objects(window: Window) -> Tensor:
    """[B, N, T, F]: what is seen of each object, 0 where it is not known."""
    origin, pos, quat = _origin(window), window.pos, window.quat
    known = window.known * window.present[:, None]
    apart = pos - window.hand_pos[:, :, None]
    near = torch.einsum("btji,btnj->btni", window.hand_rot, apart)
    with_hand = (known * window.hand_known[..., None])[..., None]
    first, second, both = _changes(pos, known)
    turn = logarithm(multiply(quat[:, 1:], conjugate(quat[:, :-1]))) * both[:, 1:, :, None]
    turn = torch.cat([torch.zeros_like(turn[:, :1]), turn], dim=1)
    bottom = pos[..., 2:] - window.half[:, None, :, 2:]  # above the lowest of the window
    lowest = torch.where(known[..., None] > 0, bottom, torch.inf).amin((1, 2), keepdim=True)
    lowest = torch.where(torch.isfinite(lowest), lowest, torch.zeros_like(lowest))
    still = torch.cat([window.half / _HALF, window.friction[..., None] / _SMOOTH], dim=-1)
    seen = known[..., None]
    x = torch.cat(
        [
            seen * (pos - origin) / _PLACE,
            seen * (bottom - lowest) / _PLACE,
            with_hand * apart / _PLACE,
            with_hand * near / _PLACE,
            first / _STEP,
            _fine(first, _STEP),
            second / _CHANGE,
            _fine(second, _CHANGE),
            turn / _TURN,
            seen * _columns(quat),
            known[..., None],
            both[..., None],
            still[:, None].expand(-1, pos.shape[1], -1, -1),
        ],
        dim=-1,
    )
    return x.transpose(1, 2)


def _hand(window: Window) -> Tensor:
    """[B, T, F]: what is seen of the hand."""
    seen = window.hand_known[..., None]
    first, second, _ = _changes(window.hand_pos, window.hand_known)
    rot = window.hand_rot[..., :2].flatten(-2)
    place = (window.hand_pos - _origin(window)[:, 0]) / _PLACE
    return torch.cat([seen * place, seen * rot, first / _STEP, second / _CHANGE], dim=-1)


def _fine(change: Tensor, unit: float) -> Tensor:
    """Small changes spread out, large ones drawn together: what rests is told from what creeps."""
    return torch.asinh(change / (0.05 * unit)) / 3.0


def _columns(quat: Tensor) -> Tensor:
    """[..., 3]: which way the object's first axis points. A cube's other axes say no more here."""
    w, x, y, z = quat.unbind(-1)
    return torch.stack(
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)], dim=-1
    )


def log_likelihood(found: Posterior, true: Tensor, mask: Tensor) -> Tensor:
    """[B]: of the true logarithms [B, 1 + N], where `mask` [B, 1 + N] has 1."""
    each = -0.5 * ((true - found.mean) / found.spread).square() - found.spread.log()
    return ((each - 0.5 * math.log(2.0 * math.pi)) * mask).sum(1)


def divergence(found: Posterior, prior: Tensor, mask: Tensor) -> Tensor:
    """[B]: Kullback-Leibler divergence from the prior, rows [1 + N, 2] of mean and deviation."""
    ratio = found.spread / prior[:, 1]
    away = (found.mean - prior[:, 0]) / prior[:, 1]
    return ((0.5 * (ratio.square() + away.square() - 1.0) - ratio.log()) * mask).sum(1)
