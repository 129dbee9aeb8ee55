"""When a reported effect is the injected one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from blind import mechanism
from blind.identities import identical
from orbisim.effects import EffectInstance

Floats = npt.NDArray[np.float64]
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
    """Whether what was found is the injected effect by another name that is exact in this scene
    (`identities.identical`), with numbers to match; counted apart from `same`.
    """
    return any(_near(found, one, model) for one in identical(_instance(truth), model))


NEAR = 0.1
"""How far the numbers of an identical effect may be off, relative."""


def _near(found: Found, wanted: EffectInstance, model: mujoco.MjModel) -> bool:
    if key(found) != (wanted.effect, wanted.target):
        return False
    numbers = {name: _number(value) for name, value in found["parameters"].items()}
    if not set("xyz") <= set(wanted.values):
        return all(abs(numbers[n] - v) <= NEAR * abs(v) for n, v in wanted.values.items())
    without = np.array(model.opt.gravity) if wanted.effect == "gravity_tilt" else np.zeros(3)
    is_ = _felt(_vector(numbers) - without, wanted.target, model)
    should = _felt(_vector(wanted.values) - without, wanted.target, model)
    return bool(np.linalg.norm(is_ - should) <= NEAR * np.linalg.norm(should))


def _felt(push: Floats, target: str, model: mujoco.MjModel) -> Floats:
    """A constant force [3] on a target without the part along which it cannot move."""
    joint = None if target == "world" else mechanism.only_joint(model, target)
    if joint is not None and mechanism.slides(model, joint):
        along = mechanism.axis(model, joint)
        return along * (along @ push)
    normal = mechanism.planar_normal(model)
    return push if normal is None else push - normal * (normal @ push)


def _vector(numbers: Mapping[str, float]) -> Floats:
    return np.array([numbers[axis] for axis in "xyz"])


def _instance(effect: Found) -> EffectInstance:
    values = {name: _number(value) for name, value in effect["parameters"].items()}
    return EffectInstance(str(effect["effect"]), str(effect["target"]), values)


def _number(value: Any) -> float:
    return float(value["value"] if isinstance(value, Mapping) else value)


def all_found(found: Sequence[Found], truths: Sequence[Found]) -> bool:
    """Whether every injected effect is among the reported ones."""
    return all(any(same(one, truth) for one in found) for truth in truths)
