"""From JSON to the dataclasses of this package, with types checked on the way."""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeVar

from orbisim.errors import InputError

T = TypeVar("T")


def checked(kind: type[T], value: Any, where: str) -> T:
    """A value from JSON as the type that an annotation names.

    Args:
      kind: a dataclass, `int`, `float`, `bool`, `str`, a `Literal`, or a tuple or dict of them.
      value: what JSON has.
      where: its place in the document; named in errors.

    Raises:
      InputError: it is of another type, not finite, or of an unknown name.
    """
    converted: T = _converted(kind, value, where)
    return converted


def _converted(kind: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return _tuples(value)
    if dataclasses.is_dataclass(kind):
        return _dataclass(kind, value, where)
    if origin is Literal:
        return _choice(arguments, value, where)
    if origin is tuple:
        return _tuple(arguments, value, where)
    if origin is dict:
        return _dict(arguments, value, where)
    if origin is types.UnionType:  # of something and None
        inner = next(a for a in arguments if a is not type(None))
        return None if value is None else _converted(inner, value, where)
    return _number_or_text(kind, value, where)


def _number_or_text(kind: Any, value: Any, where: str) -> Any:
    fits = isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
    if kind is float:
        fits = isinstance(value, (int, float)) and not isinstance(value, bool)
        value = _float(value) if fits else value
        fits = fits and math.isfinite(value)
    if not fits:
        raise InputError(f"{where}: expected {kind.__name__}; got {_short(value)}")
    return value


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _choice(choices: tuple[Any, ...], value: Any, where: str) -> Any:
    if not any(value == choice and type(value) is type(choice) for choice in choices):
        raise InputError(f"{where}: expected one of {', '.join(map(repr, choices))}; "
                         f"got {_short(value)}")  # fmt: skip
    return value


def _tuple(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise InputError(f"{where}: expected a list; got {_short(value)}")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        raise InputError(f"{where}: expected {len(kinds)} entries; got {len(value)}")
    each = enumerate(zip(kinds, value, strict=True))
    return tuple(_converted(kind, item, f"{where}[{i}]") for i, (kind, item) in each)


def _dict(kinds: tuple[Any, ...], value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: expected an object; got {_short(value)}")
    return {name: _converted(kinds[1], item, f"{where}.{name}") for name, item in value.items()}


def _dataclass(kind: Any, value: Any, where: str) -> Any:
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: expected an object; got {_short(value)}")
    known = _fields(kind)
    if unknown := sorted(value.keys() - known.keys()):
        raise InputError(f"{where}: has an unknown entry {unknown[0]!r}")
    if missing := sorted(_required(kind) - value.keys()):
        raise InputError(f"{where}: has no entry {missing[0]!r}")
    return kind(**{n: _converted(known[n], v, f"{where}.{n}") for n, v in value.items()})


@functools.cache
def _fields(kind: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


@functools.cache
def _required(kind: Any) -> frozenset[str]:
    missing = dataclasses.MISSING
    return frozenset(
        field.name
        for field in dataclasses.fields(kind)
        if field.default is missing and field.default_factory is missing
    )


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, (list, tuple)) else value


def _short(value: Any) -> str:
    if isinstance(value, (Mapping, Sequence)) and not isinstance(value, str):
        return f"{type(value).__name__} of {len(value)}"
    return repr(value)[:80]
