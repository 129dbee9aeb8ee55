"""Results that are kept by the numbers they were computed from."""

from __future__ import annotations

import numpy as np

from orbisim.host.kept import Kept, key_of


def test_a_result_is_computed_once_and_the_oldest_goes() -> None:
    asked: list[int] = []
    kept = Kept[np.ndarray](lambda one: one.nbytes, 2 * 8 * 10)

    def of(number: int, length: int = 10) -> np.ndarray:
        def compute() -> np.ndarray:
            asked.append(number)
            return np.full(length, float(number))

        found = kept.of(key_of(number, length), compute)
        assert (found == number).all() and len(found) == length
        return found

    first = of(1)
    assert of(1) is first and asked == [1]
    of(2)
    of(1)  # used last, so that 2 goes
    of(3)
    of(1)
    assert asked == [1, 2, 3]
    of(2)
    assert asked == [1, 2, 3, 2]
    of(4, 21)  # more than the budget: given, not kept
    of(4, 21)
    assert asked == [1, 2, 3, 2, 4, 4]


def test_a_key_tells_numbers_shapes_and_types_apart() -> None:
    one = np.arange(6.0)
    parts = [
        (one,), (one.reshape(2, 3),), (one.astype(np.float32),), (one, one), (one[:3], one[3:]),
        (np.append(one[:5], 5.1),), (one[::-1],), (one, True), (one, False),
    ]  # fmt: skip
    assert len({key_of(*some) for some in parts}) == len(parts)
    assert key_of(one[::2]) == key_of(one[::2].copy())
    assert key_of(np.array([np.nan])) == key_of(np.array([np.nan]))
