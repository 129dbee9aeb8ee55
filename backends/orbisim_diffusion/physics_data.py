"""Windows of episodes for PhyInf, with errors like those of states that were read off frames."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import torch
from orbisim_world_model.entities import Context
from orbisim_world_model.kinematics import Kinematics
from orbisim_world_model.pack import Pack
from orbisim_world_model.properties import volume
from orbisim_world_model.rotation import exponential, multiply
from torch import Tensor

from orbisim.errors import InputError
from orbisim_diffusion.physics import FRAMES, Window

_SHORTEST = 22
"""Frames of the shortest window that training shows."""
_RAREST = 0.0025
"""Errors are at most 20 times as large as the scale says: beyond, an object counts as not seen."""
_MOVING = 0.005
"""m a frame: a tenth of a metre a second."""
_SHORT, _HIDDEN = 0.2, 0.25
"""Shares of windows that are shorter, and of objects that some frames do not show."""


@dataclasses.dataclass(frozen=True)
class Noise:
    """What is read off frames is off by so much; each window draws its own share.

    As `orbisim infer` errs. In 28 films cubes that rest are 0.10 mm off in the median from where
    the film has them at rest (root mean square of the horizontal axes; 90 % 0.7), moving ones 0.6
    (75 % 1.4, 90 % 5.6), and then the next frame is off by 0.74 of it (lags 2 and 3: 0.63, 0.54):
    a fit begins where the last one ended. Heights are 0.1 mm off, since what rests is assumed to.
    A network that is trained on errors that rest and motion share sees how still a resting cube is
    and takes its motion to be as exact.

    Attributes:
      rest, motion: scales of what is new in a frame, of an object at rest, and of one that moves by
        `_MOVING` or more; Student's distribution with two degrees of freedom, m.
      stays: largest share of a frame's error that the next one has, too. upwards: of all this.
      turn: of an object from frame to frame, rad. offset, tilt: of a window, m and rad.
      joint, bent: of joints from frame to frame and of a window, rad.
      exact: share of windows without any of it.
    """

    rest: float = 0.00005
    motion: float = 0.0005
    stays: float = 0.95
    upwards: float = 0.2
    turn: float = 0.015
    offset: float = 0.0015
    tilt: float = 0.02
    joint: float = 0.003
    bent: float = 0.005
    exact: float = 0.4


class Truth(NamedTuple):
    """What windows were drawn from.

    Attributes:
      first: [B] row of a pack that a window begins with. episode: [B] its episode.
      logs: [B, 1 + N] logarithms of the table's friction and the objects' densities.
      mask: [B, 1 + N], 0 for padding.
    """

    first: Tensor
    episode: Tensor
    logs: Tensor
    mask: Tensor


def usable(pack: Pack) -> Pack:
    """The episodes that are long enough for a window.

    Raises:
      InputError: there are none, or the scene has no hand, no table or no objects.
    """
    layout = pack.layout
    if not (layout.objects and layout.hand and layout.surface):
        raise InputError(
            "PhyInf needs episodes of a robot with a hand, objects and a table that they lie on"
        )
    long = (pack.length >= FRAMES - 1).nonzero()[:, 0]
    if not len(long):
        raise InputError(f"no episode has {FRAMES} frames, which a window of PhyInf takes")
    return pack.subset(long)


def densities(pack: Pack) -> Tensor:
    """[E, N], kg/m^3; 1 for padding."""
    columns = pack.layout.attributes
    rows = torch.where(pack.mask[..., None] > 0, pack.attributes, pack.attributes[:, :1])
    size = volume(rows.flatten(0, 1), columns).unflatten(0, rows.shape[:2])
    found = rows[..., columns.index("mass")] / size
    return torch.where(pack.mask > 0, found, torch.ones_like(found))


def frictions(pack: Pack) -> Tensor:
    """[E] of the table."""
    return pack.world[:, pack.layout.settings.index("friction_slide")]


def changed(context: Context, pack: Pack, values: Tensor) -> Context:
    """Descriptors with other friction of the table and densities, [B, 1 + N], with gradients.

    Masses and inertia go with the densities; sizes stay.
    """
    layout = pack.layout
    columns, settings = layout.attributes, layout.settings
    there = context.mask if context.mask is not None else torch.ones_like(values[:, 1:])
    rows = torch.where(there[..., None] > 0, context.attributes, context.attributes[:, :1])
    size = volume(rows.flatten(0, 1), columns).unflatten(0, rows.shape[:2])
    mass = columns.index("mass")
    ratio = values[:, 1:] * size / rows[..., mass]
    ratio = torch.where(there > 0, ratio, torch.ones_like(ratio))
    heavy = [mass, *(columns.index(f"inertia_{axis}") for axis in "xyz")]
    one = torch.ones(len(columns), device=rows.device)
    one[heavy] = 0.0  # ratio where it counts, 1 elsewhere
    attributes = context.attributes * (one + (1.0 - one) * ratio[..., None])
    place = settings.index("friction_slide")
    world = context.world
    world = torch.cat([world[:, :place], values[:, :1], world[:, place + 1 :]], dim=1)
    return context._replace(attributes=attributes, world=world)


class Windows:
    """Draws windows of a pack of episodes (see `usable`)."""

    def __init__(self, pack: Pack, noise: Noise | None = None) -> None:
        self.pack, self.noise = pack, noise or Noise()
        self.kinematics = Kinematics(pack.layout).to(pack.device)
        self._density, self._friction = densities(pack).log(), frictions(pack).log()
        columns = pack.layout.attributes
        self._half = pack.attributes[..., [columns.index(f"half_{axis}") for axis in "xyz"]]
        self._own = pack.attributes[..., columns.index("friction_slide")]

    def draw(self, count: int) -> Truth:
        """Windows that begin anywhere."""
        pack = self.pack
        episode = torch.randint(pack.episodes, (count,), device=pack.device)
        room = pack.length[episode] - (FRAMES - 1)
        late = (torch.rand(count, device=pack.device) * (room + 1)).long().minimum(room)
        return self.at(episode, pack.start[episode] + late)

    def every(self, apart: int) -> Truth:
        """A window every so many frames of every episode."""
        pack = self.pack
        episodes: list[int] = []
        firsts: list[int] = []
        for number, (start, length) in enumerate(
            zip(pack.start.tolist(), pack.length.tolist(), strict=True)
        ):
            begins = range(start, start + length - FRAMES + 2, apart)
            firsts += begins
            episodes += [number] * len(begins)
        return self.at(*(torch.tensor(x, device=pack.device) for x in (episodes, firsts)))

    def at(self, episode: Tensor, first: Tensor) -> Truth:
        """Windows that begin at given rows."""
        table = self._friction[episode][:, None]
        logs = torch.cat([table, self._density[episode]], dim=1)
        mask = torch.cat([torch.ones_like(table), self.pack.mask[episode]], dim=1)
        return Truth(first, episode, logs, mask)

    def way(self, truth: Truth) -> Tensor:
        """[B, N]: m that each object goes along the table in its window."""
        rows = truth.first[:, None] + torch.arange(FRAMES, device=self.pack.device)
        pos = self.pack.states(rows).pos[..., :2].unflatten(0, rows.shape)
        return (pos[:, 1:] - pos[:, :-1]).norm(dim=-1).sum(1)

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def seen(self, truth: Truth, noisy: bool = True) -> Window:
        """Windows as frames show them: turned about the vertical, off by noise, with gaps."""
        pack, noise = self.pack, self.noise
        count, device = len(truth.first), pack.device
        rows = truth.first[:, None] + torch.arange(FRAMES, device=device)
        x = pack.states(rows)
        objects = x.pos.shape[1]
        q, pos, quat = (v.unflatten(0, rows.shape) for v in (x.q, x.pos, x.quat))
        known = pack.mask[truth.episode][:, None].expand(-1, FRAMES, -1).clone()
        hand_known = torch.ones(count, FRAMES, device=device)
        if noisy:
            share = torch.rand(count, 1, 1, 1, device=device)
            share = share * (torch.rand_like(share) > noise.exact)
            # a normal number over the root of half a chi-square of two degrees of freedom
            even = torch.rand(count, FRAMES, objects, 1, device=device)
            wild = (-even.log()).clamp_min(_RAREST).rsqrt()

            def white() -> Tensor:
                return torch.randn(count, FRAMES, objects, 3, device=device) * wild

            def whole(size: float) -> Tensor:
                return size * torch.randn(count, 1, objects, 3, device=device)

            new = white() * (noise.rest + (noise.motion - noise.rest) * _motion(pos)[..., None])
            kept = noise.stays * torch.rand(count, 1, 1, device=device).sqrt()
            new = torch.einsum("bts,bsni->btni", _stay(kept), new)
            level = torch.tensor([1.0, 1.0, noise.upwards], device=device)
            # what is new in a frame has from nothing to four times its scale
            pos = pos + share * whole(noise.offset) + 4.0 * share.square() * new * level
            spin = noise.turn * white() + whole(noise.tilt)
            quat = multiply(exponential(share * spin), quat)
            bent = noise.joint * torch.randn_like(q) + noise.bent * torch.randn_like(q[:, :1])
            hinge = torch.tensor([float(h) for h in pack.layout.hinge], device=device)
            q = q + share[..., 0] * bent * hinge
            known, hand_known = _gaps(known, hand_known)
        hand = self.kinematics(q.flatten(0, 1), torch.zeros_like(q).flatten(0, 1))
        hand = hand.unflatten(0, (count, FRAMES))
        hand_pos, hand_rot = hand[..., :3], hand[..., 3:12].unflatten(-1, (3, 3))
        if noisy:
            half = math.pi * torch.rand(count, device=device)
            zero = torch.zeros_like(half)
            yaw = torch.stack([half.cos(), zero, zero, half.sin()], dim=-1)
            turn = _vertical(2.0 * half)
            pos = torch.einsum("bij,btnj->btni", turn, pos)
            quat = multiply(yaw[:, None, None].expand_as(quat), quat)
            hand_pos = torch.einsum("bij,btj->bti", turn, hand_pos)
            hand_rot = torch.einsum("bij,btjk->btik", turn, hand_rot)
        return Window(
            hand_pos, hand_rot, pos, quat, hand_known, known,
            self._half[truth.episode], self._own[truth.episode], pack.mask[truth.episode],
        )  # fmt: skip


def _motion(pos: Tensor) -> Tensor:
    """[B, T, N] of pos [B, T, N, 3]: 0 for what rests, 1 for what moves by `_MOVING` or more."""
    way = (pos[:, 1:] - pos[:, :-1]).norm(dim=-1)
    none = torch.zeros_like(way[:, :1])
    either = torch.cat([none, way], dim=1).maximum(torch.cat([way, none], dim=1))
    return (either / _MOVING).clamp_max(1.0)


def _stay(kept: Tensor) -> Tensor:
    """[B, T, T]: what errors that are new at times s have left at times t, `kept` [B, 1, 1] of it
    from frame to frame."""
    time = torch.arange(FRAMES, device=kept.device)
    later = time[:, None] - time
    return torch.where(later >= 0, kept ** later.clamp_min(0), torch.zeros_like(kept))


def _vertical(angle: Tensor) -> Tensor:
    """[B, 3, 3]: turns about the vertical."""
    c, s, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([c, -s, zero, s, c, zero, zero, zero, one], dim=-1).unflatten(-1, (3, 3))


def _gaps(known: Tensor, hand_known: Tensor) -> tuple[Tensor, Tensor]:
    """Some windows are shorter; some objects are not seen for a while."""
    count, frames, objects = known.shape
    device = known.device
    time = torch.arange(frames, device=device)
    length = torch.randint(_SHORTEST, frames + 1, (count,), device=device)
    length = torch.where(torch.rand(count, device=device) < _SHORT, length, frames)
    within = (time < length[:, None]).float()
    begin = torch.randint(frames, (count, 1, objects), device=device)
    lasts = torch.randint(1, frames // 2, (count, 1, objects), device=device)
    hidden = (time[:, None] >= begin) & (time[:, None] < begin + lasts)
    hidden &= torch.rand(count, 1, objects, device=device) < _HIDDEN
    return known * within[..., None] * ~hidden, hand_known * within
