"""Moves that add."""

from collections.abc import Iterator
from typing import Any, cast

import pytest

from orbisim.diagnosis.reselection import _last
from orbisim.diagnosis.simplification import Sure
from orbisim.host.deadline import TimeIsUpError


def _named(*names: str) -> list[Sure]:
    return [Sure(cast(Any, name)) for name in names]


def _names(every: Iterator[Sure]) -> Iterator[Any]:
    yield from _last(every)


def test_the_last_of_many_is_compared() -> None:
    assert list(_names(iter(_named("all", "fewer", "sure")))) == ["sure"]
    assert list(_names(iter(()))) == []


def test_what_a_set_had_come_to_is_compared_when_the_time_is_up() -> None:
    def ended() -> Iterator[Sure]:
        yield from _named("all", "fewer")
        raise TimeIsUpError

    found = _names(ended())
    assert next(found) == "fewer"
    with pytest.raises(TimeIsUpError):
        next(found)
