"""Arguments of a backend, checked before they reach an engine.

Engines answer what they cannot use with errors of their own, or not at all: a negative count runs
nothing, a complex control loses its imaginary part. Here it becomes an `InputError` that says what
was got and what is expected.
"""

from __future__ import annotations

import math
import operator
from typing import Any

import mujoco
import numpy as np

from orbisim.errors import InputError
from orbisim.state import Array, State

_REAL = "biuf"
"""NumPy's kinds of boolean, integer, unsigned and floating-point numbers."""


def whole_number(name: str, value: Any, least: int) -> int:
    """A count as an `int`.

    Raises:
      InputError: it is not a whole number, or less than `least`.
    """
    try:
        count = operator.index(value)
    except TypeError:
        count = least - 1
    if count < least:
        raise InputError(f"{name} must be a whole number of at least {least}; got {value!r}")
    return count


def positive_number(name: str, value: Any) -> float:
    """A finite number above zero.

    Raises:
      InputError: it is not.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 < number < math.inf:
        raise InputError(f"{name} must be a finite number above 0; got {value!r}")
    return number


def real_array(name: str, values: Any, expected: str) -> Array:
    """Numbers as a float64 array; a torch tensor stays one.

    Args:
      name: of the argument. expected: its shape, in words; both for the message.

    Raises:
      InputError: they are not real numbers in equal rows.
    """
    if hasattr(values, "detach"):
        if values.is_complex():
            raise InputError(f"{name} is complex; expected real numbers of shape {expected}")
        return values
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):
        raise InputError(
            f"{name} has rows of different lengths; expected one array of shape {expected}"
        ) from None
    if array.dtype.kind not in _REAL:
        got = "complex" if array.dtype.kind == "c" else f"{type(values).__name__} of {array.dtype}"
        raise InputError(f"{name} is {got}; expected real numbers of shape {expected}")
    return np.asarray(array, np.float64)


def check_finite(name: str, values: Array) -> None:
    """Raises `InputError` naming the first entry that is NaN or infinite."""
    on_device = hasattr(values, "detach")
    if bool((values.isfinite() if on_device else np.isfinite(values)).all()):
        return
    host = values.detach().cpu().numpy() if on_device else values
    index = tuple(int(i) for i in np.argwhere(~np.isfinite(host))[0])
    raise InputError(f"{name}{list(index)} is {host[index]}; controls must be finite")


def check_state(state: Any, model: mujoco.MjModel, scene: str) -> None:
    """Raises `InputError` if this is no state of at least one world with the model's sizes."""
    if not isinstance(state, State):
        raise InputError(
            f"state must be a State, as reset and step return it; got {type(state).__name__}"
        )
    nworld = state.nworld
    if nworld == 0:
        raise InputError("the state has no worlds; at least one is needed")
    for name, size in (("qpos", model.nq), ("qvel", model.nv), ("act", model.na)):
        _check_array(name, getattr(state, name), (nworld, size), scene)
    for name, shape in memory_shapes(model).items():
        if name in state.memory:
            _check_array(f"memory[{name!r}]", state.memory[name], (nworld, *shape), scene)


def _check_array(name: str, array: Any, expected: tuple[int, ...], scene: str) -> None:
    shape = tuple(array.shape)
    if shape != expected:
        raise InputError(f"State.{name} has shape {shape}; scene {scene!r} needs {expected}")
    complex_or_text = (
        array.dtype.kind not in _REAL if isinstance(array, np.ndarray) else array.is_complex()
    )
    if complex_or_text:
        raise InputError(f"State.{name} holds {array.dtype}; expected real numbers")


def memory_shapes(model: mujoco.MjModel) -> dict[str, tuple[int, ...]]:
    """Shape, without the world axis, of each entry of `orbisim.state.MEMORY`."""
    return {
        "qacc_warmstart": (model.nv,),
        "history": (model.nhistory,),
        "plugin_state": (model.npluginstate,),
        "qfrc_applied": (model.nv,),
        "xfrc_applied": (model.nbody, 6),
        "eq_active": (model.neq,),
        "mocap_pos": (model.nmocap, 3),
        "mocap_quat": (model.nmocap, 4),
        "userdata": (model.nuserdata,),
    }
