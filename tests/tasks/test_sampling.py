"""Seeds, and drawing from ranges."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks.sampling import Range, episode_seed, override, stream


@dataclasses.dataclass(frozen=True)
class Config:
    range: Range = (0.0, 1.0)
    steps: int = 10
    flag: bool = False
    noise: float = 0.5


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"range": 0.25}, Config(range=(0.25, 0.25))),
        ({"range": [1, 2]}, Config(range=(1.0, 2.0))),
        ({"steps": 3}, Config(steps=3)),
        ({"flag": True}, Config(flag=True)),
        ({"noise": 1}, Config(noise=1.0)),
        ({}, Config()),
    ],
)
def test_fields_are_replaced(changes: dict[str, Any], expected: Config) -> None:
    assert override(Config(), changes) == expected


@pytest.mark.parametrize(
    "changes",
    [
        {"range": (2, 1)}, {"range": (1, 2, 3)}, {"range": float("nan")}, {"range": (0, np.inf)},
        {"steps": (1, 2)}, {"steps": True}, {"flag": 1}, {"noise": [0.1]},
    ],
)  # fmt: skip
def test_values_of_another_form_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(changes))):
        override(Config(), changes)


def test_unknown_fields_are_named() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'noise'"):
        override(Config(), {"nosie": 1.0})


def test_seeds_fit_in_a_signed_integer_and_differ() -> None:
    seeds = [episode_seed(s, t, "x", i) for s in (0, 2**40) for t in "ab" for i in range(100)]
    assert len(set(seeds)) == 400
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_streams_are_separate_and_repeatable() -> None:
    first, again, other = stream(5, 0), stream(5, 0), stream(5, 1)
    numbers = first.random(4)
    np.testing.assert_array_equal(numbers, again.random(4))
    assert not np.array_equal(numbers, other.random(4))
