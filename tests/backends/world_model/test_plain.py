"""From JSON to dataclasses."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import pytest
from orbisim_world_model.plain import checked

from orbisim.errors import InputError


@dataclasses.dataclass(frozen=True)
class Inner:
    size: int
    name: str = "none"


@dataclasses.dataclass(frozen=True)
class Outer:
    rate: float
    kind: Literal["a", "b"]
    flags: tuple[bool, ...]
    pair: tuple[int, str]
    inner: Inner
    table: dict[str, float]
    maybe: int | None = None


GOOD: dict[str, Any] = {
    "rate": 1,
    "kind": "a",
    "flags": [True, False],
    "pair": [1, "x"],
    "inner": {"size": 3},
    "table": {"x": 0.5},
}


def test_what_fits() -> None:
    found = checked(Outer, {**GOOD, "maybe": 4}, "doc")
    expected = Outer(1.0, "a", (True, False), (1, "x"), Inner(3), {"x": 0.5}, 4)
    assert found == expected
    assert type(found.rate) is float
    assert checked(Any, [1, [2]], "doc") == (1, (2,))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate": "1"}, r"doc\.rate: expected float; got '1'"),
        ({"rate": True}, r"doc\.rate: expected float"),
        ({"rate": math.nan}, r"doc\.rate: expected float; got nan"),
        ({"rate": 10**400}, r"doc\.rate: expected float"),
        ({"kind": "c"}, r"doc\.kind: expected one of 'a', 'b'; got 'c'"),
        ({"flags": [1]}, r"doc\.flags\[0\]: expected bool"),
        ({"flags": "no"}, r"doc\.flags: expected a list"),
        ({"pair": [1]}, r"doc\.pair: expected 2 entries; got 1"),
        ({"inner": {"size": 1.5}}, r"doc\.inner\.size: expected int; got 1\.5"),
        ({"inner": {"size": True}}, r"doc\.inner\.size: expected int"),
        ({"inner": {}}, r"doc\.inner: has no entry 'size'"),
        ({"inner": [1]}, r"doc\.inner: expected an object; got list of 1"),
        ({"table": {"x": None}}, r"doc\.table\.x: expected float"),
        ({"other": 1}, r"doc: has an unknown entry 'other'"),
        ({"maybe": "x"}, r"doc\.maybe: expected int"),
    ],
)
def test_what_does_not(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        checked(Outer, {**GOOD, **change}, "doc")
