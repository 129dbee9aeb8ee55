"""Training sequences."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from orbisim_world_model.pack import Pack
from orbisim_world_model.sampling import Windows, generator_of

from orbisim.errors import InputError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate


@pytest.fixture(scope="module")
def pack() -> Pack:
    whole = simulate(TABLE, 3, 10, 4)
    return dataclasses.replace(whole, length=torch.tensor([10, 3, 6]))


def test_every_sequence_lies_within_its_episode(pack: Pack) -> None:
    windows = Windows(pack, 4, toy().model)
    assert windows.count == 7 + 0 + 3
    rows, episodes = windows.locate(torch.arange(windows.count))
    assert episodes.tolist() == [0] * 7 + [2] * 3
    assert rows.tolist() == [*range(7), 22, 23, 24]


def test_a_sequence_is_what_the_episode_holds(pack: Pack) -> None:
    windows = Windows(pack, 4, toy().model)
    batch = windows.batch(*windows.locate(torch.tensor([2, 8])))
    assert batch.states.q.shape == (5, 2, 2)
    assert batch.control.shape == (4, 2, 2)
    torch.testing.assert_close(batch.control[:, 1], pack.ctrl[23:27])
    torch.testing.assert_close(batch.states.q[:, 0], pack.states(torch.arange(2, 7)).q)
    assert batch.base is None


def test_the_step_decides_what_is_drawn(pack: Pack) -> None:
    windows = Windows(pack, 4, toy().model)
    first, again, other, seed = (
        windows.draw(50, generator_of("cpu", *key))[0] for key in ((1, 5), (1, 5), (1, 6), (2, 5))
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert not torch.equal(first, seed)
    assert set(first.tolist()) <= {*range(7), 22, 23, 24}


def test_sequences_that_no_episode_has(pack: Pack) -> None:
    with pytest.raises(InputError, match="no episode has 11 control steps; the longest has 10"):
        Windows(pack, 11, toy().model)
    with pytest.raises(InputError, match="--residual-on mujoco"):
        Windows(pack, 4, toy(model__baseline="mujoco").model)
