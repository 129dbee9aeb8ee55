"""Seeds of episodes, and drawing from ranges."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from orbisim.errors import InputError, UnknownNameError

Range = tuple[float, float]
C = TypeVar("C")


def episode_seed(seed: int, task: str, subtask: str, index: int) -> int:
    """The seed of one episode of a collection: a number below 2**63."""
    words = [seed, zlib.crc32(task.encode()), zlib.crc32(subtask.encode()), index]
    return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0] >> 1)


def stream(seed: int, purpose: int) -> np.random.Generator:
    """A generator for one purpose (0 the scene's parameters, 1 the layout and the policy).

    Separate streams keep the layout and the actions of an episode the same when the ranges of the
    scene's parameters change.
    """
    return np.random.default_rng([seed, purpose])


def override(config: C, changes: Mapping[str, Any]) -> C:
    """A configuration with some fields replaced; a number stands for the range that holds only it.

    Raises:
      UnknownNameError: there is no field of a name.
      InputError: a value does not have the form of the field's.
    """
    fields = {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}  # type: ignore[arg-type]
    new: dict[str, Any] = {}
    for name, value in changes.items():
        if name not in fields:
            raise UnknownNameError("setting of the task", name, fields)
        new[name] = _like(name, fields[name], value)
    return dataclasses.replace(config, **new)  # type: ignore[type-var]


def _like(name: str, old: Any, value: Any) -> Any:
    if isinstance(old, tuple):
        pair = (value, value) if isinstance(value, (int, float)) else tuple(value)
        if len(pair) != 2 or not all(np.isfinite(pair)) or pair[0] > pair[1]:
            raise InputError(f"{name} is a range LOW,HIGH or one number; got {value!r}")
        return tuple(type(old[0])(v) for v in pair)
    if isinstance(value, (tuple, list)) or isinstance(old, bool) != isinstance(value, bool):
        raise InputError(f"{name} is one {type(old).__name__}; got {value!r}")
    return type(old)(value)
