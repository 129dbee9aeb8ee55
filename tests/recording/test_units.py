"""Units as people write them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim.recording import units

KNOWN = {
    "deg": ("rad", math.pi / 180), "°": ("rad", math.pi / 180), "Degrees": ("rad", math.pi / 180),
    "mrad": ("rad", 1e-3), "rev": ("rad", 2 * math.pi), "rpm": ("rad/s", math.pi / 30),
    "RPM": ("rad/s", math.pi / 30), "rev/min": ("rad/s", math.pi / 30),
    "deg/s": ("rad/s", math.pi / 180), "°/s": ("rad/s", math.pi / 180),
    "rad s^-1": ("rad/s", 1.0), "rad*s^-1": ("rad/s", 1.0), "dps": ("rad/s", math.pi / 180),
    "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "ns": ("s", 1e-9), "min": ("s", 60.0),
    "mm": ("m", 1e-3), "cm": ("m", 1e-2), "mm/s": ("m/s", 1e-3), "m/s²": ("m/s^2", 1.0),
    "m/s/s": ("m/s^2", 1.0), "g": ("m/s^2", 9.80665), "deg/s^2": ("rad/s^2", math.pi / 180),
    "Nm": ("N*m", 1.0), "mNm": ("N*m", 1e-3), "N·m": ("N*m", 1.0), "N m": ("N*m", 1.0),
    "kgf*cm": ("N*m", 0.0980665), "Ncm": ("N*m", 1e-2), "kN": ("N", 1e3),
    "lbf": ("N", 4.44822161526),
    "%": ("1", 0.01), "": ("1", 1.0), "-": ("1", 1.0), "uT": ("T", 1e-6), "mA": ("A", 1e-3),
    " deg ": ("rad", math.pi / 180),
}  # fmt: skip


@pytest.mark.parametrize("text", KNOWN)
def test_known_units(text: str) -> None:
    unit = units.parse(text)
    assert (unit.si, unit.text) == (KNOWN[text][0], text)
    assert unit.factor == pytest.approx(KNOWN[text][1], rel=1e-9)


@pytest.mark.parametrize("text", ["ticks", "foo", "/s", "rad/", "left", "[3]", "m//s", "x" * 99])
def test_other_words_are_no_units(text: str) -> None:
    assert not units.known(text)
    with pytest.raises(ValueError, match="unit"):
        units.parse(text)


@given(st.text(max_size=50))
def test_any_text_is_a_unit_or_is_not(text: str) -> None:
    if units.known(text):
        assert units.parse(text).factor > 0


@given(st.sampled_from(sorted(KNOWN)), st.floats(-1e9, 1e9))
def test_there_and_back(text: str, value: float) -> None:
    unit = units.parse(text)
    there = units.converted(np.array([value]), unit)
    assert there[0] == pytest.approx(value * unit.factor, rel=1e-12)
    assert there[0] / unit.factor == pytest.approx(value, rel=1e-12)


def test_decimal_prefixes_are_exact() -> None:
    ticks = np.arange(0, 5000, 10)
    assert (units.converted(ticks, units.parse("ms")) == [float(f"{n}e-3") for n in ticks]).all()


def test_what_is_in_si_is_not_copied() -> None:
    values = np.arange(3.0)
    assert units.converted(values, units.parse("rad")) is values


@given(st.sampled_from(["", "n", "u", "m", "k", "M"]), st.sampled_from(["s", "m", "N", "Nm", "A"]))
def test_prefixes_scale(prefix: str, symbol: str) -> None:
    size = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}[prefix]
    unit = units.parse(prefix + symbol)
    assert unit.factor == pytest.approx(size)
    assert unit.si == units.parse(symbol).si
