"""StaInf: states of robot and objects, sizes and colours from a single frame's latent."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim.scene.visible import ROBOT
from orbisim_diffusion.config import PATCH
from orbisim_diffusion.solids import Solids, matrices
from orbisim_diffusion.store import Store
from orbisim_diffusion.symmetry import angle, rotation_error

OBJECTS, JOINTS = 4, 9
"""Most objects and joints; the tasks have up to four cubes, a Panda with its fingers has nine."""
_WIDTH, _HEADS, _ENCODER, _DECODER = 128, 4, 3, 2
_ORIGIN = (0.5, 0.0, 0.1)
_ROBOT = 3 + 6 + 2 * JOINTS
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


class StateInference(nn.Module):
    """StaInf (paper, appendix B.3): a light head on the frozen encoder's latents.

    A transformer over the latents, and a query for the robot and for each object.

    Args:
      channels: of a latent. size: height and width of the images, pixels.
    """

    def __init__(self, channels: int, size: int) -> None:
        super().__init__()
        places = (size // PATCH) ** 2
        self.enter = nn.Linear(channels, _WIDTH)
        self.place = nn.Parameter(0.02 * torch.randn(places, _WIDTH))
        self.queries = nn.Parameter(torch.randn(1 + OBJECTS, _WIDTH))
        options = {"dim_feedforward": 4 * _WIDTH, "dropout": 0.0, "activation": "gelu"}
        self.encoder = nn.TransformerEncoder(
            nn.TransformerEncoderLayer(
                _WIDTH, _HEADS, batch_first=True, norm_first=True, **options
            ),
            _ENCODER,
            enable_nested_tensor=False,
        )
        self.decoder = nn.TransformerDecoder(
            nn.TransformerDecoderLayer(
                _WIDTH, _HEADS, batch_first=True, norm_first=True, **options
            ),
            _DECODER,
            norm=nn.LayerNorm(_WIDTH),
        )
        self.robot, self.object = nn.Linear(_WIDTH, _ROBOT), nn.Linear(_WIDTH, _OBJECT)

    def forward(self, latents: Tensor) -> Inferred:
        """Of latents [B, C, h, w] of the frozen encoder."""
        memory = self.encoder(self.enter(latents.flatten(2).transpose(1, 2)) + self.place)
        found = self.decoder(self.queries.expand(len(latents), -1, -1), memory).float()
        robot, each = self.robot(found[:, 0]).float(), self.object(found[:, 1:]).float()
        origin = robot.new_tensor(_ORIGIN)
        sine, cosine = robot[:, 9 : 9 + JOINTS], robot[:, 9 + JOINTS :]
        return Inferred(
            hand_pos=origin + 0.3 * robot[:, :3],
            hand_rot=_rotation(robot[:, 3:9]),
            joints=torch.atan2(sine, cosine),
            present=each[..., 0],
            pos=origin + 0.3 * each[..., 1:4],
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


def inference_loss(found: Inferred, true: Truth) -> Tensor:
    """Errors of robot and objects, each object compared with the one that it fits best.

    Positions in units of 2 cm, sizes of 10 %, colours of 0.1, joints of 0.1 rad.
    """
    hand = _smooth((found.hand_pos - true.hand_pos) / 0.02).mean()
    turn = (found.hand_rot - true.hand_rot).square().sum((-1, -2)).mean()
    joints = (_smooth((found.joints - true.joints) / 0.1) * true.jointed).mean()
    chosen = matched(found, true)
    there = true.there
    count = there.sum().clamp_min(1)
    present = nn.functional.binary_cross_entropy_with_logits(chosen.present, there.float())
    pos = (_smooth((chosen.pos - true.pos) / 0.02).mean(-1) * there).sum() / count
    size = (_smooth(_log_ratio(chosen.size, true.size) / 0.1).mean(-1) * there).sum() / count
    colour = (_smooth((chosen.colour - true.colour) / 0.1).mean(-1) * there).sum() / count
    rot = _of(rotation_error(chosen.rot, true.rot, true.size), there).sum() / count
    return hand + turn + joints + present + pos + size + colour + rot


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
    joint = (found.joints - true.joints).abs() * true.jointed
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
