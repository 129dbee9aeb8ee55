"""Errors of open-loop predictions on held-out episodes, by horizon."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.losses import object_loss, robot_loss
from orbisim_world_model.pack import Pack
from orbisim_world_model.rotation import conjugate, geodesic_distance, logarithm, multiply
from orbisim_world_model.sampling import Windows
from orbisim_world_model.unroll import open_loop

HORIZONS = (10, 50, 100)
"""Steps at which errors are reported: the paper's 10 and 100, and one between."""
BURN = 8
"""Control steps of true states that every model sees before it predicts."""


@torch.no_grad()  # type: ignore[untyped-decorator]
def evaluate(
    model: Dynamics,
    pack: Pack,
    horizons: Sequence[int] = HORIZONS,
    *,
    burn: int = BURN,
    limit: int = 512,
) -> dict[str, Any]:
    """Errors of a model on episodes.

    Args:
      model: on the pack's device.
      pack: held-out episodes.
      horizons: numbers of control steps; those that no episode has are left out.
      burn: see `BURN`.
      limit: at most so many episodes.

    Returns:
      For each horizon and quantity its median, mean, 90 and 95 % quantile and largest value over
      the episodes: `trajerr` (L_state, mean over the steps up to the horizon), and at the horizon
      itself `object_position` (mm), `object_rotation` (deg), `object_velocity` (mm/s),
      `hand_position`, `hand_rotation`, `hand_velocity`, `joint_position`, `joint_velocity` (of the
      robot), `part_angle` (deg) and `part_travel` (mm) of the joints of parts, and
      `normalised` (root mean square over joints, in units of each coordinate's spread in the data).
    """
    was_training = model.training
    model.eval()
    result: dict[str, Any] = {}
    for horizon in horizons:
        long_enough = pack.length >= horizon + burn
        if not bool(long_enough.any()):
            continue
        chosen = torch.nonzero(long_enough)[:limit, 0]
        errors = _errors(model, pack.subset(chosen), horizon, burn)
        result[str(horizon)] = {name: _summary(values) for name, values in errors.items()}
        result[str(horizon)]["episodes"] = len(chosen)
    model.train(was_training)
    return result


def _errors(model: Dynamics, pack: Pack, horizon: int, burn: int) -> dict[str, Tensor]:
    """[episodes] for each quantity."""
    windows = Windows(pack, horizon + burn, model.config)
    first = torch.cat([torch.zeros_like(pack.start[:1]), windows.ends[:-1]])
    batch = windows.batch(*windows.locate(first))
    predicted = open_loop(model, batch, burn)
    truth = Entities(*(field[burn + 1 :] for field in batch.states))
    mask, layout = pack.mask, pack.layout
    if layout.hand and not model.config.extended:
        predicted = predicted._replace(q=truth.q, v=truth.v)  # the paper's state has no joints
    each = [
        robot_loss(predicted.at(t), truth.at(t), layout)
        + object_loss(predicted.at(t), truth.at(t), mask)
        for t in range(horizon)
    ]
    found = {"trajerr": torch.stack(each).mean(0)}
    end, there = predicted.at(-1), truth.at(-1)
    if mask.shape[1]:
        found |= _object_errors(end, there, mask)
    if layout.hand:
        found["hand_position"] = (end.hand_pos - there.hand_pos).norm(dim=-1) * 1e3
        turn = geodesic_distance(end.hand_rot, there.hand_rot)
        found["hand_rotation"] = torch.rad2deg(turn)
        found["hand_velocity"] = (end.hand_vel - there.hand_vel).norm(dim=-1) * 1e3
    if layout.has_robot and model.config.extended:
        own = list(range(len(layout.joints)) if layout.articulated else layout.robot_joints)
        found["joint_position"] = (end.q - there.q)[:, own].square().mean(-1).sqrt()
        found["joint_velocity"] = (end.v - there.v)[:, own].square().mean(-1).sqrt()
        if layout.parts and not layout.articulated:
            found |= _part_errors(end, there, batch.context, layout)
        found["normalised"] = normalised(predicted, truth, pack)
    return {name: torch.nan_to_num(values, nan=torch.inf) for name, values in found.items()}


def _object_errors(end: Entities, there: Entities, mask: Tensor) -> dict[str, Tensor]:
    def mean(values: Tensor) -> Tensor:
        return (values * mask).sum(1) / mask.sum(1)

    turn = logarithm(multiply(end.quat, conjugate(there.quat))).norm(dim=-1)
    return {
        "object_position": mean((end.pos - there.pos).norm(dim=-1)) * 1e3,
        "object_rotation": torch.rad2deg(mean(turn)),
        "object_velocity": mean((end.vel - there.vel).norm(dim=-1)) * 1e3,
    }


def _part_errors(
    end: Entities, there: Entities, context: Context, layout: Layout
) -> dict[str, Tensor]:
    """Greatest error among an episode's hinges, and among its slides; 0 where it has none."""
    assert context.parts is not None and context.part_mask is not None
    off = (end.q - there.q)[:, list(layout.parts)].abs() * context.part_mask
    hinge = context.parts[..., layout.part_columns.index("type_hinge")]
    turned = torch.rad2deg(off * hinge).amax(1)
    return {"part_angle": turned, "part_travel": (off * (1.0 - hinge)).amax(1) * 1e3}


def normalised(predicted: Entities, truth: Entities, pack: Pack) -> Tensor:
    """Root mean square over joints and steps up to the horizon, in units of their spread."""
    if pack.layout.articulated:
        return _normalised_limbs(predicted, truth, pack)
    keep = [j for j in range(len(pack.layout.joints)) if not pack.layout.ignored[j]]
    spread_q = pack.qpos[:, list(pack.layout.joint_q)].std(0).clamp_min(1e-6)
    spread_v = pack.qvel[:, list(pack.layout.joint_v)].std(0).clamp_min(1e-6)
    dq = ((predicted.q - truth.q) / spread_q)[..., keep]
    dv = (predicted.v - truth.v) / spread_v
    return torch.cat([dq, dv], dim=-1).square().mean((0, 2)).sqrt()


def _normalised_limbs(predicted: Entities, truth: Entities, pack: Pack) -> Tensor:
    """The same of episodes of several robots, each in units of its own data."""
    ignored = pack.parts[..., pack.layout.part_columns.index("ignored")]
    there = pack.part_mask
    whose, squares = pack.robots(), []
    for field, rows, counts in (("q", pack.qpos, there * (1.0 - ignored)), ("v", pack.qvel, there)):
        spread = torch.ones_like(there)
        for robot in whose.unique():
            mine = whose == robot
            spread[mine] = rows[pack.rows(mine)].std(0).clamp_min(1e-6)
        error = ((getattr(predicted, field) - getattr(truth, field)) / spread).square().mean(0)
        squares.append((error * counts, counts))
    total = sum(error.sum(1) for error, _ in squares)
    return (total / sum(count.sum(1) for _, count in squares)).sqrt()


def _summary(values: Tensor) -> dict[str, float]:
    values = values.double().cpu()
    return {
        "median": float(values.median()),
        "mean": float(values.mean()),
        "p90": float(values.quantile(0.9)),
        "p95": float(values.quantile(0.95)),
        "worst": float(values.max()),
    }


def constant_velocity(pack: Pack, config: ModelConfig) -> Dynamics:
    """The baseline that goes on as it was."""
    still = dataclasses.replace(
        config, kind="constant_velocity", residual=True, manifold=True, relative=False
    )
    if not config.extended and not pack.layout.hand:
        still = dataclasses.replace(still, extended=True, control="ctrl")
    model = Dynamics(pack.layout, still).build(pack.controls(still).shape[1])
    return model.to(pack.device)
