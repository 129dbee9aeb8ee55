"""What a task must offer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim import tasks
from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks.base import Scripted, shares


def test_shares_add_up() -> None:
    assert shares([120, 640, 1840], 2600) == [120, 640, 1840]
    assert shares([120, 640, 1840], 10) == [1, 2, 7]
    assert sum(shares([1, 1, 1], 100)) == 100


@given(
    weights=st.lists(st.integers(0, 2000), min_size=1, max_size=6).filter(any),
    total=st.integers(0, 5000),
)
def test_shares_are_fair(weights: list[int], total: int) -> None:
    found = shares(weights, total)
    assert sum(found) == total
    exact = [total * weight / sum(weights) for weight in weights]
    assert all(abs(part - share) < 1 for part, share in zip(found, exact, strict=True))


def test_which_episodes_make_up_a_collection() -> None:
    push = tasks.make("push")
    assert len(push.allotment(None)) == 2600
    assert push.allotment(3, "three") == [("three", 0), ("three", 1), ("three", 2)]
    few = push.allotment(10)
    assert [name for name, _ in few].count("to_hit") == 7
    assert few[-1] == ("to_hit", 6)
    with pytest.raises(InputError, match="at least one episode; got 0"):
        push.allotment(0)
    with pytest.raises(UnknownNameError, match="did you mean 'to_hit'"):
        push.allotment(2, "to_hut")


def test_names_and_defaults() -> None:
    push = tasks.make("push")
    assert push.label == "task:push"
    assert push.check_subtask(None) == "to_hit"
    assert push.timestep == push.scene().model.opt.timestep
    with pytest.raises(UnknownNameError, match="unknown setting"):
        tasks.make("toss", frictoin=0.2)


def scripted(held: float, **changes: Any) -> Scripted:
    values = {"scene": None, "initial": None, "sequence": np.arange(4.0).reshape(1, 4, 1)}
    return Scripted(**{**values, **changes}, held=held)  # type: ignore[arg-type]


@pytest.mark.parametrize("step", [0.1, 0.05, 0.02])
def test_controls_are_held(step: float) -> None:
    controls = scripted(0.1).controls(0.4, step, seed=0)[0, :, 0]
    times = np.arange(len(controls)) * step
    np.testing.assert_array_equal(controls, np.floor(times / 0.1 + 1e-9))
    assert scripted(0.1).horizon == pytest.approx(0.4)


def test_the_last_control_goes_on() -> None:
    assert scripted(0.1).controls(1.0, 0.1, seed=0)[0, :, 0].tolist() == [0, 1, 2, *[3] * 7]
