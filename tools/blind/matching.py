"""When a reported effect is the injected one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

Found = Mapping[str, Any]

NEAR_ONE = ("torque_gain", "sensor_scale", "clock_skew")
"""Factors: their error is taken relative to how far the true one is from 1."""


def key(effect: Found) -> tuple[str, str]:
    """Name and target."""
    return str(effect["effect"]), str(effect["target"])


def value_of(effect: Found) -> float:
    """The first parameter, of a report's effect or of a truth's."""
    first = next(iter(effect["parameters"].values()))
    return float(first["value"] if isinstance(first, Mapping) else first)


def relative_error(found: Found, truth: Found) -> float:
    """Of the first parameter."""
    was, is_ = value_of(truth), value_of(found)
    if truth["effect"] in NEAR_ONE:
        return abs(is_ - was) / abs(was - 1.0)
    return abs(is_ - was) / max(abs(was), 1e-12)


def same(found: Found, truth: Found) -> bool:
    """The same effect at the same target."""
    return key(found) == key(truth)


def equivalent(found: Found, truth: Found, model: mujoco.MjModel) -> bool:
    """The same force by another name: identities of mechanics, not likenesses.

    Accepted besides `same` (and counted apart from it):
    - a constant force straight up at a body's centre of mass is buoyancy, and the other way round;
    - where a body's centre of mass moves with a single hinge or slide, at a constant distance, drag
      on the body is damping of that joint of the same power;
    - on the only body that moves, another direction of gravity is a constant force of the weight's
      change, if that is what was found;
    - on a horizontal slide, a mass more on the body is armature of the slide, and a force along it
      is an offset of the motor that drives it.
    """
    return any(
        rule(*pair, model)
        for rule in (_lift, _lone_drag, _tilted, _level_slide)
        for pair in ((found, truth), (truth, found))
    )


def _lift(a: Found, b: Found, model: mujoco.MjModel) -> bool:
    if (a["effect"], b["effect"]) != ("constant_force", "buoyancy") or a["target"] != b["target"]:
        return False
    parts = np.array([_number(a["parameters"][axis]) for axis in "xyz"])
    return bool(parts[2] > 0.98 * np.linalg.norm(parts))


def _lone_drag(a: Found, b: Found, model: mujoco.MjModel) -> bool:
    pairs = {("linear_drag", "viscous_damping"), ("quadratic_drag", "quadratic_damping")}
    return (a["effect"], b["effect"]) in pairs and _only_joint(model, a["target"]) == b["target"]


def _tilted(a: Found, b: Found, model: mujoco.MjModel) -> bool:
    if (a["effect"], b["effect"]) != ("constant_force", "gravity_tilt") or model.nbody != 2:
        return False
    force = np.array([_number(a["parameters"][axis]) for axis in "xyz"])
    gravity = np.array([_number(b["parameters"][axis]) for axis in "xyz"])
    change = float(model.body_mass[1]) * (gravity - model.opt.gravity)
    return bool(np.linalg.norm(force - change) <= 0.1 * np.linalg.norm(change))


def _level_slide(a: Found, b: Found, model: mujoco.MjModel) -> bool:
    names = (a["effect"], b["effect"])
    if names not in {("payload", "armature"), ("constant_force", "torque_bias")}:
        return False
    joint = _only_joint(model, a["target"])
    if joint is None or model.joint(joint).type[0] != int(mujoco.mjtJoint.mjJNT_SLIDE):
        return False
    if abs(model.joint(joint).axis @ model.opt.gravity) > 1e-9:
        return False
    if names[0] == "payload":
        return bool(b["target"] == joint)
    driven = model.actuator(b["target"]).trnid[0]
    return bool(model.joint(int(driven)).name == joint)


def _only_joint(model: mujoco.MjModel, body: str) -> str | None:
    """The joint that alone moves a body, if it is a single hinge or slide."""
    try:
        number = model.body(body).id
    except KeyError:
        return None
    found: list[int] = []
    while number:
        first, count = int(model.body_jntadr[number]), int(model.body_jntnum[number])
        found += range(first, first + count) if count else []
        number = int(model.body_parentid[number])
    scalar = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
    if len(found) != 1 or int(model.jnt_type[found[0]]) not in scalar:
        return None
    return str(model.joint(found[0]).name)


def _number(value: Any) -> float:
    return float(value["value"] if isinstance(value, Mapping) else value)


def all_found(found: Sequence[Found], truths: Sequence[Found]) -> bool:
    """Whether every injected effect is among the reported ones."""
    return all(any(same(one, truth) for one in found) for truth in truths)
