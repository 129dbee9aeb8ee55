"""A time on the clock."""

from __future__ import annotations

import pytest

from orbisim.errors import OrbiSimError
from orbisim.host.deadline import NEVER, Deadline, TimeIsUpError


def test_it_passes() -> None:
    assert not NEVER.passed and NEVER.left == float("inf")
    NEVER.check()
    later = Deadline.after(1000.0)
    assert not later.passed and 990 < later.left <= 1000
    over = Deadline.after(-1.0)
    assert over.passed and over.left < 0
    with pytest.raises(TimeIsUpError):
        over.check()


def test_it_is_no_failure_of_a_suspect() -> None:
    assert not issubclass(TimeIsUpError, OrbiSimError)
