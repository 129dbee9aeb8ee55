"""Models drawn around the declared one: another for each episode."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import mujoco
import numpy as np
import yaml

from orbisim.errors import InputError, UnknownNameError
from orbisim.files.reading import size_of

Factors: TypeAlias = Mapping[str, tuple[float, float]]
"""Smallest and largest factor by quantity (`mass`), or quantity and element (`mass/forearm`)."""

_MOST_BYTES = 1_000_000
"""Of a YAML file; a line for each body has some kilobytes, and parsing YAML is slow."""


def _scale_mass(model: mujoco.MjModel, body: int, factor: float) -> None:
    model.body_mass[body] *= factor
    model.body_inertia[body] *= factor


def _scale_gain(model: mujoco.MjModel, actuator: int, factor: float) -> None:
    model.actuator_gainprm[actuator] *= factor
    model.actuator_biasprm[actuator] *= factor


def _of_dofs(field: str) -> Callable[[mujoco.MjModel, int, float], None]:
    def scale(model: mujoco.MjModel, joint: int, factor: float) -> None:
        start = int(model.jnt_dofadr[joint])
        getattr(model, field)[start : start + _DOFS[int(model.jnt_type[joint])]] *= factor

    return scale


def _scale_stiffness(model: mujoco.MjModel, joint: int, factor: float) -> None:
    model.jnt_stiffness[joint] *= factor


def _scale_friction(model: mujoco.MjModel, geom: int, factor: float) -> None:
    model.geom_friction[geom, 0] *= factor


_DOFS = {0: 6, 1: 3, 2: 1, 3: 1}
"""Degrees of freedom by `mjtJoint`."""
_QUANTITIES: Mapping[str, tuple[str, str, Callable[[mujoco.MjModel, int, float], None]]] = {
    "mass": ("body", "nbody", _scale_mass),
    "damping": ("joint", "njnt", _of_dofs("dof_damping")),
    "frictionloss": ("joint", "njnt", _of_dofs("dof_frictionloss")),
    "armature": ("joint", "njnt", _of_dofs("dof_armature")),
    "stiffness": ("joint", "njnt", _scale_stiffness),
    "friction": ("geom", "ngeom", _scale_friction),
    "gain": ("actuator", "nu", _scale_gain),
}
"""For each quantity the kind of element that has it, the field with their number, and how it is
scaled: mass with the inertia, friction by its sliding coefficient, gain with the bias (kp)."""


def factors_of(text: str) -> dict[str, tuple[float, float]]:
    """What `--randomize` says: a percentage of everything, or a YAML file.

    The file has a percentage or a range of factors for each quantity (mass, damping, frictionloss,
    armature, stiffness, friction, gain), or for one element's (`mass/forearm: [0.8, 1.5]`).

    Raises:
      InputError: it is neither, or a factor is not above 0.
      UnknownNameError: there is no such quantity.
    """
    try:
        return {name: _range("--randomize", float(text.strip().removesuffix("%")))
                for name in _QUANTITIES}  # fmt: skip
    except ValueError as error:
        if isinstance(error, InputError):
            raise
    path = Path(text)
    if not path.is_file():
        raise InputError(f"--randomize is a percentage, such as 20, or a YAML file; got {text!r}")
    if size_of(path) > _MOST_BYTES:
        raise InputError(f"{path}: has more than {_MOST_BYTES} bytes")
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no YAML: {' '.join(str(error).split())}") from None
    return checked(found, str(path))


def checked(found: Any, source: str = "randomize") -> dict[str, tuple[float, float]]:
    """Factors from plain values.

    Raises:
      InputError: a value is no percentage and no range. UnknownNameError: no such quantity.
    """
    if not isinstance(found, Mapping) or not found:
        raise InputError(f"{source}: expected a quantity and its range on each line (mass: 20)")
    for name in found:
        if str(name).partition("/")[0] not in _QUANTITIES:
            raise UnknownNameError(f"quantity to randomize in {source}", str(name), _QUANTITIES)
    return {str(name): _range(f"{source}: {name}", value) for name, value in found.items()}


def _range(what: str, value: Any) -> tuple[float, float]:
    try:
        if isinstance(value, int | float) and not isinstance(value, bool):
            low, high = 1 - value / 100, 1 + value / 100
        else:
            low, high = (float(part) for part in value)
    except (TypeError, ValueError):
        low, high = math.nan, math.nan
    if not 0 < low <= high < math.inf:
        raise InputError(
            f"{what} is a percentage below 100, or two factors above 0, the smaller first; "
            f"got {value!r}"
        )
    return low, high


def drawn(model: mujoco.MjModel, factors: Factors, random: np.random.Generator) -> mujoco.MjModel:
    """A copy of a model with quantities scaled, each element by a factor of its own, drawn evenly.

    A factor for an element is applied on top of one for all.

    Raises:
      UnknownNameError: the model has no such element.
    """
    copied = copy.copy(model)
    for name, (low, high) in factors.items():
        quantity, _, element = name.partition("/")
        kind, count, scale = _QUANTITIES[quantity]
        chosen = [_index(model, kind, element)] if element else range(int(getattr(model, count)))
        for index in chosen:
            scale(copied, index, float(random.uniform(low, high)))
    mujoco.mj_setConst(copied, mujoco.MjData(copied))
    return copied


def _index(model: mujoco.MjModel, kind: str, name: str) -> int:
    try:
        return int(getattr(model, kind)(name).id)
    except KeyError:
        known = [getattr(model, kind)(i).name for i in range(getattr(model, _COUNTS[kind]))]
        raise UnknownNameError(kind, name, filter(None, known), "needed by --randomize") from None


_COUNTS = {kind: count for kind, count, _ in _QUANTITIES.values()}
