"""Where numbers stand: loops and tables, by brute force."""

from __future__ import annotations

import itertools

import pytest
import torch
from orbisim_world_model.native.values import Access, Value, accesses, contiguous


def read(shape: tuple[int, ...], access: Access) -> list[int]:
    """The indices that a loop nest visits, in order."""
    if access.table:
        return list(access.table)
    turns = itertools.product(*map(range, shape))
    return [
        access.offset + sum(i * stride for i, stride in zip(turn, access.strides, strict=True))
        for turn in turns
    ]


WHOLE = contiguous("a", 5, (2, 3, 4))
CASES = {
    "whole": WHOLE,
    "turned": WHOLE.moved(WHOLE.index.permute(2, 0, 1).reshape(2, 3, 4)),
    "slice": Value("b", contiguous("b", 0, (4, 6, 8)).index[1:3, ::2, 2:6]),
    "flipped": WHOLE.moved(WHOLE.index.flip(2)),
    "broadcast": contiguous("c", 0, (3, 1)),
    "scalar": contiguous("d", 3, ()),
    "gathered": WHOLE.moved(WHOLE.index[[1, 0]][:, [2, 0, 1]]),
}


@pytest.mark.parametrize("names", [*itertools.combinations(CASES, 2), ("whole",), tuple(CASES)])
def test_loops_visit_the_numbers_in_order(names: tuple[str, ...]) -> None:
    values = [CASES[name] for name in names]
    sizes, found = accesses((2, 3, 4), values)
    for value, access in zip(values, found, strict=True):
        assert access.buffer == value.buffer
        visited = read(sizes, access)
        assert visited == value.index.expand(2, 3, 4).reshape(-1).tolist()


def test_neighbouring_loops_are_merged() -> None:
    sizes, (access,) = accesses((2, 3, 4), [WHOLE])
    assert sizes == (24,)
    assert (access.offset, access.strides, access.table) == (5, (1,), ())


def test_numbers_that_follow_no_pattern_have_a_table() -> None:
    odd = Value("a", torch.tensor([0, 1, 5, 2]))
    _, (access,) = accesses((4,), [odd])
    assert access.table == (0, 1, 5, 2)
