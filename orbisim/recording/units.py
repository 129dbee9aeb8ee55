"""Units as people write them, and what they are in SI (with radians).

`mNm`, `deg/s`, `rad s^-1`, `m/s²`, `kgf*cm`, `rpm`: factors with exponents, multiplied by `*`,
`·`, `.` or a space, divided by `/`. The factors are those of the SI brochure (9th edition, 2019);
kgf and lbf are the standard ones (9.80665 N, 4.4482216152605 N).
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

Dimensions = tuple[tuple[str, int], ...]

AS_IT_IS = "SI"
"""A unit that says: no conversion, whatever the name in front of it looks like."""
_GRAVITY = 9.80665  # m/s^2, the standard one that units of force rest on
_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6}
_PREFIXED: Mapping[str, dict[str, int]] = {
    "m": {"m": 1},
    "s": {"s": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Nm": {"kg": 1, "m": 2, "s": -2},
    "Hz": {"s": -1},
    "A": {"A": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "W": {"kg": 1, "m": 2, "s": -3},
    "T": {"kg": 1, "s": -2, "A": -1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
}
"""Symbols that take a prefix."""
_N, _NM = _PREFIXED["N"], _PREFIXED["Nm"]
_OTHERS: Mapping[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}), "%": (0.01, {}), "percent": (0.01, {}), "none": (1.0, {}),
    "dimensionless": (1.0, {}), "-": (1.0, {}),
    "kg": (1.0, {"kg": 1}),
    "sec": (1.0, {"s": 1}), "secs": (1.0, {"s": 1}), "second": (1.0, {"s": 1}),
    "seconds": (1.0, {"s": 1}), "msec": (1e-3, {"s": 1}), "usec": (1e-6, {"s": 1}),
    "nsec": (1e-9, {"s": 1}),
    "milliseconds": (1e-3, {"s": 1}), "microseconds": (1e-6, {"s": 1}),
    "nanoseconds": (1e-9, {"s": 1}), "min": (60.0, {"s": 1}), "minute": (60.0, {"s": 1}),
    "minutes": (60.0, {"s": 1}), "h": (3600.0, {"s": 1}), "hour": (3600.0, {"s": 1}),
    "radian": (1.0, {"rad": 1}), "radians": (1.0, {"rad": 1}),
    "deg": (math.pi / 180, {"rad": 1}), "degs": (math.pi / 180, {"rad": 1}),
    "degree": (math.pi / 180, {"rad": 1}), "degrees": (math.pi / 180, {"rad": 1}),
    "rev": (2 * math.pi, {"rad": 1}), "revs": (2 * math.pi, {"rad": 1}),
    "turn": (2 * math.pi, {"rad": 1}), "turns": (2 * math.pi, {"rad": 1}),
    "arcmin": (math.pi / 10800, {"rad": 1}), "arcsec": (math.pi / 648000, {"rad": 1}),
    "rpm": (math.pi / 30, {"rad": 1, "s": -1}), "rps": (2 * math.pi, {"rad": 1, "s": -1}),
    "dps": (math.pi / 180, {"rad": 1, "s": -1}), "mps": (1.0, {"m": 1, "s": -1}),
    "meter": (1.0, {"m": 1}), "meters": (1.0, {"m": 1}), "metre": (1.0, {"m": 1}),
    "metres": (1.0, {"m": 1}), "in": (0.0254, {"m": 1}), "inch": (0.0254, {"m": 1}),
    "ft": (0.3048, {"m": 1}),
    # among the signals of a recording there are accelerations and no masses
    "g": (_GRAVITY, {"m": 1, "s": -2}), "mg": (1e-3 * _GRAVITY, {"m": 1, "s": -2}),
    "newton": (1.0, _N), "kgf": (_GRAVITY, _N), "gf": (1e-3 * _GRAVITY, _N),
    "lbf": (4.4482216152605, _N), "ozf": (4.4482216152605 / 16, _N),
    "Ncm": (1e-2, _NM), "Nmm": (1e-3, _NM), "gauss": (1e-4, _PREFIXED["T"]),
}  # fmt: skip
_NAMES = {
    "1": {}, "s": {"s": 1}, "m": {"m": 1}, "rad": {"rad": 1}, "m/s": {"m": 1, "s": -1},
    "rad/s": {"rad": 1, "s": -1}, "m/s^2": {"m": 1, "s": -2}, "rad/s^2": {"rad": 1, "s": -2},
    "N": _N, "N*m": _NM, **{k: v for k, v in _PREFIXED.items() if k not in ("Nm", "s", "m", "rad")},
}  # fmt: skip
_WORD = 3
"""Letters from which on a spelling may differ in case (RPM, Deg): shorter ones are symbols, where
m and M are a thousandth and a million."""
_LONGEST = 40
"""Letters of a unit."""
_SIGNS = str.maketrans({
    "\u00b5": "u", "\u03bc": "u", "\u2212": "-", "\u207b": "-",  # micro, mu, minus
    "·": "*", "⋅": "*", "°": "deg", "²": "2", "³": "3", "¹": "1",
})  # fmt: skip
_FACTOR = re.compile(r"([A-Za-z]+|%|1|-)(?:\^?(-?[1-3]))?")


@dataclasses.dataclass(frozen=True)
class Unit:
    """A unit.

    Attributes:
      text: as it was written. si: the SI unit of the same dimension. factor: how many of these.
    """

    text: str
    si: str
    factor: float


@functools.cache
def parse(text: str) -> Unit:
    """The unit that a text names.

    Raises:
      ValueError: it names none that is known.
    """
    if text == AS_IT_IS:
        return Unit(text, AS_IT_IS, 1.0)
    plain = text.strip().translate(_SIGNS).replace("**", "^").replace(" per ", "/")
    if len(plain) > _LONGEST:
        raise ValueError(f"{plain[:_LONGEST]!r}... is not a unit")
    above, *below = plain.split("/")
    factor, powers = 1.0, dict[str, int]()
    for part, sign in [(above, 1), *((one, -1) for one in below)]:
        factor *= _multiply(part.strip() or ("1" if not below else "?"), sign, powers, text)
    return Unit(text, _name({k: n for k, n in powers.items() if n}), factor)


def known(text: str) -> bool:
    """Whether `parse` knows the unit."""
    try:
        parse(text)
    except ValueError:
        return False
    return True


def converted(values: npt.NDArray[Any], unit: Unit) -> npt.NDArray[Any]:
    """Values in SI; the array itself where there is nothing to do."""
    if unit.factor == 1.0:
        return values
    inverse = round(1.0 / unit.factor)
    if unit.factor < 1.0 and math.isclose(inverse * unit.factor, 1.0, rel_tol=1e-12):
        return np.asarray(values / inverse)  # 10 ms are 0.01 s to the last digit
    return np.asarray(values * unit.factor)


def _multiply(product: str, sign: int, powers: dict[str, int], text: str) -> float:
    """The factor of a product without quotients; its dimensions are added to `powers`."""
    factor = 1.0
    for atom in re.split(r"\s*[*.]\s*|\s+", product):
        match = _FACTOR.fullmatch(atom)
        found = _atom(match[1]) if match else None
        if match is None or found is None:
            raise ValueError(f"{text!r} is not a unit that is known")
        exponent = sign * int(match[2] or 1)
        factor *= found[0] ** exponent
        for dimension, power in found[1].items():
            powers[dimension] = powers.get(dimension, 0) + exponent * power
    return factor


def _atom(symbol: str) -> tuple[float, Mapping[str, int]] | None:
    if symbol in _OTHERS:
        return _OTHERS[symbol]
    if symbol in _PREFIXED:
        return 1.0, _PREFIXED[symbol]
    if symbol[1:] in _PREFIXED and symbol[0] in _PREFIXES:
        return _PREFIXES[symbol[0]], _PREFIXED[symbol[1:]]
    if len(symbol) >= _WORD and symbol.lower() in {*_OTHERS, "rad"}:
        return _atom(symbol.lower())
    return None


def _name(powers: Mapping[str, int]) -> str:
    for name, dimensions in _NAMES.items():
        if dimensions == powers:
            return name
    return "*".join(k if n == 1 else f"{k}^{n}" for k, n in sorted(powers.items()))
