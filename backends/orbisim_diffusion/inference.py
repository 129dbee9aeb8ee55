"""StaInf: states of robot and objects, sizes and colours from a single frame's latent."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim.scene.visible import ROBOT
from orbisim_diffusion.blocks import (
    Attention,
    ResidualBlock,
    as_image,
    as_sequence,
    conv,
    norm,
)
from orbisim_diffusion.config import PATCH
from orbisim_diffusion.solids import Solids, View, matrices, project, rays
from orbisim_diffusion.store import Store
from orbisim_diffusion.symmetry import angle, rotation_error

OBJECTS, JOINTS = 4, 9
"""Most objects and joints; the tasks have up to four cubes, a Panda with its fingers has nine."""
_WIDTH, _FINE, _HEADS, _BLOCKS = 96, 48, 4, 4
_FINER = 2
"""Cells along a latent's side."""
_THRESHOLD = -0.85
"""Logit from which on a peak is an object (0.3)."""
_HEIGHT, _FARTHEST = 0.025, 3.0
"""Where a cell looks: at this height above the table, m, and not farther than so many depths."""
_ORIGIN = (0.5, 0.0, 0.1)
# hand's position and orientation, sine and cosine of joints
_ROBOT = 3 + 6 + 2 * JOINTS
# whether one is there, position, orientation, size, colour
_OBJECT = 1 + 3 + 6 + 3 + 3


class Inferred(NamedTuple):
    """What is read off frames; B of them, N objects in no particular order.

    Attributes:
      hand_pos: [B, 3], m. hand_rot: [B, 3, 3]. joints: [B, 9] positions, rad or m; those that the
        robot has come first.
      present: [B, N] logit of there being an object. pos: [B, N, 3], m. rot: [B, N, 3, 3], up to
        the box's symmetries. size: [B, N, 3] half sizes, m. colour: [B, N, 3].
    """

    hand_pos: Tensor
    hand_rot: Tensor
    joints: Tensor
    present: Tensor
    pos: Tensor
    rot: Tensor
    size: Tensor
    colour: Tensor


class Dense(NamedTuple):
    """What the network answers.

    Attributes:
      robot: [B, R] of `_robot_of`. grid: [B, 16, h, w] at the cells of a grid of four pixels:
        logit of an object's centre being there, and that object's place (from the cell's `base`),
        orientation, size and colour.
    """

    robot: Tensor
    grid: Tensor


class StateInference(nn.Module):
    """StaInf (paper, appendix B.3): a light head on the frozen encoder's latents.

    Convolutions and attention over the latents; the robot is read off all of them, each object off
    the cell that its centre is seen in (as detectors do, Zhou et al. 2019, "Objects as Points"),
    which needs no matching in training.

    Args:
      channels: of a latent. size: height and width of the images, pixels.
    """

    base: Tensor

    def __init__(self, channels: int, size: int) -> None:
        super().__init__()
        places = size // PATCH
        self.cells = _FINER * places
        self.enter = conv(channels + 2, _WIDTH)
        self.body = nn.ModuleList(ResidualBlock(_WIDTH, _WIDTH) for _ in range(_BLOCKS))
        self.attend = nn.ModuleList(Attention(_WIDTH, _HEADS) for _ in range(_BLOCKS // 2))
        self.grow = nn.Sequential(
            conv(_WIDTH, _FINE * _FINER**2), nn.PixelShuffle(_FINER), ResidualBlock(_FINE, _FINE)
        )
        self.object = nn.Sequential(norm(_FINE), nn.SiLU(), nn.Conv2d(_FINE, _OBJECT, 1))
        narrow = _WIDTH * 2 // 3
        self.robot = nn.Sequential(
            norm(_WIDTH),
            nn.SiLU(),
            conv(_WIDTH, narrow, stride=2),
            nn.SiLU(),
            conv(narrow, narrow, stride=2),
            nn.SiLU(),
            nn.Flatten(),
            nn.Linear(narrow * math.ceil(places / 4) ** 2, 2 * _WIDTH),
            nn.SiLU(),
            nn.Linear(2 * _WIDTH, _ROBOT),
        )
        self.register_buffer("base", torch.zeros(self.cells**2, 3))

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def look_from(self, view: View) -> None:
        """Takes the camera of the training data (the first of the views) for where cells look."""
        ray = rays(view.at(slice(0, 1)), self.cells, self.cells)[0]
        down = (_HEIGHT - view.pos[0, 2]) / ray[:, 2].clamp_max(-1e-3)
        self.base.copy_(view.pos[0] + down.clamp(0.0, _FARTHEST)[:, None] * ray)

    def dense(self, latents: Tensor) -> Dense:
        """Of latents [B, C, h, w] of the frozen encoder."""
        height, width = latents.shape[-2:]
        y = torch.linspace(-1, 1, height, device=latents.device)
        x = torch.linspace(-1, 1, width, device=latents.device)
        where = torch.stack(torch.meshgrid(y, x, indexing="ij")).expand(len(latents), 2, -1, -1)
        x = self.enter(torch.cat([latents, where.to(latents.dtype)], dim=1))
        for number, block in enumerate(self.body):
            x = block(x)
            if number % 2:
                x = as_image(self.attend[number // 2](as_sequence(x)), height, width)
        return Dense(self.robot(x).float(), self.object(self.grow(x)).float())

    def forward(self, latents: Tensor) -> Inferred:
        """What is seen: robot, and the objects at the highest peaks of the grid."""
        found = self.dense(latents)
        score = found.grid[:, 0]
        peak = nn.functional.max_pool2d(score[:, None], 3, 1, 1)[:, 0]
        score = torch.where(score == peak, score, -20.0).flatten(1)
        best, cell = score.topk(OBJECTS, dim=1)
        return _inferred(self, found, best - _THRESHOLD, cell)


def _inferred(model: StateInference, found: Dense, present: Tensor, cell: Tensor) -> Inferred:
    """The robot, and the objects of cells [B, N]."""
    index = cell[:, None].expand(-1, _OBJECT, -1)
    each = found.grid.flatten(2).gather(2, index).transpose(1, 2)  # [B, N, 16]
    robot = found.robot
    origin = robot.new_tensor(_ORIGIN)
    sine, cosine = robot[:, 9 : 9 + JOINTS], robot[:, 9 + JOINTS :]
    return Inferred(
        hand_pos=origin + 0.3 * robot[:, :3],
        hand_rot=_rotation(robot[:, 3:9]),
        joints=torch.atan2(sine, cosine),
        present=present,
        pos=model.base[cell] + 0.1 * each[..., 1:4],
        rot=_rotation(each[..., 4:10]),
        size=0.025 * each[..., 10:13].clamp(-4, 4).exp(),
        colour=each[..., 13:16].sigmoid(),
    )


class Truth(NamedTuple):
    """What `Inferred` is compared with; `there` [B, N] says which objects there are."""

    hand_pos: Tensor
    hand_rot: Tensor
    joints: Tensor
    jointed: Tensor
    there: Tensor
    pos: Tensor
    rot: Tensor
    size: Tensor
    colour: Tensor


class Robots(NamedTuple):
    """The robot's state in every frame of a store: joints [N, 9], which of them, hand 3 and 4."""

    joints: Tensor
    jointed: Tensor
    pos: Tensor
    quat: Tensor


def robots(store: Store) -> Robots:
    """Of all frames of a store; a robot with fewer joints has zeros for the others."""
    rows, masks = [], []
    for values in store.extras["robot/qpos"]:
        row = values.new_zeros((len(values), JOINTS))
        row[:, : values.shape[1]] = values
        masks.append(torch.arange(JOINTS, device=row.device).expand_as(row) < values.shape[1])
        rows.append(row)
    return Robots(
        torch.cat(rows).float(),
        torch.cat(masks),
        torch.cat(store.extras["robot/pos"]).float(),
        torch.cat(store.extras["robot/quat"]).float(),
    )


def truth(store: Store, robot: Robots, index: Tensor) -> Truth:
    """The truth of frames [B]."""
    solids = objects_of(store.solids(index))
    return Truth(
        robot.pos[index],
        matrices(robot.quat[index]),
        robot.joints[index],
        robot.jointed[index],
        solids.entity > ROBOT,
        *(solids.pos, solids.rot, solids.size, solids.colour),
    )


def objects_of(solids: Solids) -> Solids:
    """The geoms that belong to objects, four of them, others' places empty."""
    order = (solids.entity > ROBOT).to(torch.int8).argsort(dim=1, descending=True, stable=True)
    rows = torch.arange(len(order), device=order.device)[:, None]
    return Solids(*(field[rows, order[:, :OBJECTS]] for field in solids))


def inference_loss(model: StateInference, found: Dense, true: Truth, view: View) -> Tensor:
    """Errors of robot and objects, each object read off the cell that its centre is seen in.

    Positions in units of 2 cm, sizes of 10 %, colours of 0.1, joints of 0.1 rad. Objects whose
    centre is outside the image do not count.

    Args:
      model: StaInf. found: what it answers. true: the truth. view: the cameras of the frames.
    """
    count, size = model.cells, found.grid.shape[-1]
    place = project(view, true.pos)[0] + 0.5  # [B, N, 2], 0 to 1 right and down
    there = true.there & ((place >= 0) & (place < 1)).all(-1)
    column, row = (place.clamp(0, 1 - 1e-6) * count).long().unbind(-1)
    read = _inferred(model, found, true.there.float(), row * size + column)
    hand = _smooth((read.hand_pos - true.hand_pos) / 0.02).mean()
    turn = (read.hand_rot - true.hand_rot).square().sum((-1, -2)).mean()
    joints = (_smooth(_turned(read.joints - true.joints) / 0.1) * true.jointed).mean()
    number = there.sum().clamp_min(1)

    def mean(values: Tensor) -> Tensor:
        return (values * there).sum() / number

    pos = mean(_smooth((read.pos - true.pos) / 0.02).mean(-1))
    shape = mean(_smooth(_log_ratio(read.size, true.size) / 0.1).mean(-1))
    colour = mean(_smooth((read.colour - true.colour) / 0.1).mean(-1))
    rot = _of(rotation_error(read.rot, true.rot, true.size), there).sum() / number
    peaks = _peak_loss(found.grid[:, 0], place * count - 0.5, row, column, there)
    return hand + turn + joints + peaks + pos + shape + colour + rot


def _peak_loss(score: Tensor, centre: Tensor, row: Tensor, column: Tensor, there: Tensor) -> Tensor:
    """The focal loss of Zhou et al. 2019, equation 1: cells near a centre count less as wrong.

    Args:
      score: [B, h, w] logits. centre: [B, N, 2] in cells. row, column: [B, N]. there: [B, N].
    """
    height, width = score.shape[-2:]
    x = torch.arange(width, device=score.device)
    y = torch.arange(height, device=score.device)[:, None]
    apart = (x - centre[..., 0, None, None]).square() + (y - centre[..., 1, None, None]).square()
    near = (torch.exp(-0.5 * apart) * there[..., None, None]).amax(1)  # [B, h, w]
    hit = torch.zeros_like(near)
    rows = torch.arange(len(score), device=score.device)[:, None].expand_as(row)
    hit[rows[there], row[there], column[there]] = 1.0
    p = score.sigmoid()
    right = (1 - p).square() * nn.functional.logsigmoid(score) * hit
    wrong = (1 - near) ** 4 * p.square() * nn.functional.logsigmoid(-score) * (1 - hit)
    return -(right + wrong).sum() / there.sum().clamp_min(1)


def matched(found: Inferred, true: Truth) -> Inferred:
    """The found objects in the order of the true ones: the best of all assignments."""
    with torch.no_grad():
        apart = (found.pos[:, :, None] - true.pos[:, None]).norm(dim=-1) / 0.05
        shade = (found.colour[:, :, None] - true.colour[:, None]).abs().mean(-1) / 0.2
        cost = (apart.clamp(max=10) + shade - found.present[:, :, None].sigmoid()) * true.there[
            :, None
        ]  # [B, found, true]
        orders = torch.tensor(list(itertools.permutations(range(OBJECTS))), device=cost.device)
        place = torch.arange(OBJECTS, device=cost.device)
        totals = cost[:, orders, place].sum(-1)  # [B, 24]
        order = orders[totals.argmin(1)]
    rows = torch.arange(len(order), device=order.device)[:, None]
    fields = (found.present, found.pos, found.rot, found.size, found.colour)
    return Inferred(*found[:3], *(field[rows, order] for field in fields))


def errors(found: Inferred, true: Truth) -> dict[str, float]:
    """Means over frames and objects, in the units of the paper's table."""
    chosen, there = matched(found, true), true.there
    turn = angle(_of(rotation_error(chosen.rot, true.rot, true.size), there))
    hand = angle((found.hand_rot - true.hand_rot).square().sum((-1, -2)))
    share = (chosen.size / true.size.clamp_min(1e-6) - 1.0).abs().mean(-1)
    found_all = ((chosen.present > 0) == there).all(1)
    joint = _turned(found.joints - true.joints).abs() * true.jointed
    values = {
        "object_position_mm": 1e3 * (chosen.pos - true.pos).norm(dim=-1)[there].mean(),
        "object_position_mm_median": 1e3 * (chosen.pos - true.pos).norm(dim=-1)[there].median(),
        "object_rotation_deg": turn[there].rad2deg().mean(),
        "object_rotation_deg_median": turn[there].rad2deg().median(),
        "object_size_percent": 100 * share[there].mean(),
        "object_colour_mae": (chosen.colour - true.colour).abs().mean(-1)[there].mean(),
        "hand_position_mm": 1e3 * (found.hand_pos - true.hand_pos).norm(dim=-1).mean(),
        "hand_rotation_deg": hand.rad2deg().mean(),
        "joint_rad": joint.sum() / true.jointed.sum(),
        "count_right_percent": 100 * found_all.float().mean(),
    }
    return {name: round(float(value), 4) for name, value in values.items()}


def _of(values: Tensor, there: Tensor) -> Tensor:
    return torch.where(there, values, 0.0)


def _turned(joints: Tensor) -> Tensor:
    """Differences of joints within half a turn: a turn more or less looks the same."""
    return (joints + torch.pi).remainder(2 * torch.pi) - torch.pi


def _smooth(x: Tensor) -> Tensor:
    return nn.functional.smooth_l1_loss(x, torch.zeros_like(x), reduction="none")


def _log_ratio(a: Tensor, b: Tensor) -> Tensor:
    return (a.clamp_min(1e-4) / b.clamp_min(1e-4)).log()


def _rotation(columns: Tensor) -> Tensor:
    """The rotation [..., 3, 3] that Gram and Schmidt make of two columns [..., 6]."""
    x, y = columns[..., :3], columns[..., 3:]
    x = x / x.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    y = y - (x * y).sum(-1, keepdim=True) * x
    y = y / y.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)
