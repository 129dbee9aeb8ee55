"""Attributes that map one to one onto fields of an `MjSpec` element."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import mujoco

from orbisim.scene.usd.attributes import Prim

Read = Callable[[Prim, str], Any]
"""Reads an attribute; None if it is not authored."""

_LIMITED = {
    "false": mujoco.mjtLimited.mjLIMITED_FALSE,
    "true": mujoco.mjtLimited.mjLIMITED_TRUE,
    "auto": mujoco.mjtLimited.mjLIMITED_AUTO,
}


@dataclasses.dataclass(frozen=True)
class Field:
    """One attribute and the field that takes it."""

    attribute: str
    field: str
    read: Read

    def apply(self, prim: Prim, element: Any) -> None:
        """Sets the field if the attribute is authored."""
        value = self.read(prim, self.attribute)
        if value is None:
            return
        current = getattr(element, self.field)
        if hasattr(current, "__len__") and not isinstance(current, str):
            values = list(value)
            if len(values) > len(current):
                raise prim.error(
                    f"{self.attribute} holds {len(values)} numbers; expected {len(current)}"
                )
            current[: len(values)] = values
            setattr(element, self.field, current)
        else:
            setattr(element, self.field, value)


def apply(fields: Iterable[Field], prim: Prim, element: Any) -> None:
    """Sets every field whose attribute is authored."""
    for field in fields:
        field.apply(prim, element)


def number(prim: Prim, name: str) -> float | None:
    """A number as it is."""
    return prim.number(name)


def integer(prim: Prim, name: str) -> int | None:
    """A whole number."""
    value = prim.number(name)
    if value is not None and value != int(value):
        raise prim.error(f"{name} is {value}; expected a whole number")
    return None if value is None else int(value)


def flag(prim: Prim, name: str) -> bool | None:
    """A boolean."""
    return prim.flag(name, False) if prim.authored(name) else None


def vector(prim: Prim, name: str) -> Any:
    """Numbers as they are."""
    return prim.numbers(name, None)


def limited(prim: Prim, name: str) -> Any:
    """`false`, `true` or `auto`."""
    if not prim.authored(name):
        return None
    return _LIMITED[prim.choice(name, tuple(_LIMITED), "auto")]


def one_of(choices: dict[str, Any]) -> Read:
    """A token that stands for one of MuJoCo's constants."""

    def read(prim: Prim, name: str) -> Any:
        if not prim.authored(name):
            return None
        return choices[prim.choice(name, tuple(choices), "")]

    return read


def times(factor: float) -> Read:
    """A number in other units."""
    return lambda prim, name: prim.number(name, factor)


def bounds(prim: Prim, stem: str) -> Any:
    """A range written as two attributes, `<stem>:min` and `<stem>:max`; 0 where missing."""
    low, high = prim.number(f"{stem}:min"), prim.number(f"{stem}:max")
    return None if low is None and high is None else (low or 0.0, high or 0.0)
