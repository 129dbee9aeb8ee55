"""Numbers that mean something."""

from __future__ import annotations

import dataclasses
import math
import re

import pytest
import torch
from orbisim_world_model.pack import Pack
from orbisim_world_model.usable import check_numbers

from orbisim.errors import InputError
from tests.backends.world_model.synthetic import TABLE, simulate


@pytest.fixture(scope="module")
def pack() -> Pack:
    return simulate(TABLE, 3, 10, 4)


def test_what_is_in_order(pack: Pack) -> None:
    check_numbers(pack, "p")


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e11])
@pytest.mark.parametrize("name", ["qpos", "qvel", "ctrl"])
def test_episode_and_step_are_named(pack: Pack, name: str, value: float) -> None:
    values = getattr(pack, name).clone()
    values[11 + 4, 1] = value  # episodes have 11 rows
    with pytest.raises(
        InputError, match=re.escape(f"p: episode 1, step 4: {name} holds {value:g}")
    ):
        check_numbers(dataclasses.replace(pack, **{name: values}), "p")


def test_static_numbers_too(pack: Pack) -> None:
    world = pack.world.clone()
    world[2, 0] = torch.nan
    with pytest.raises(InputError, match="p: episode 2: world holds nan"):
        check_numbers(dataclasses.replace(pack, world=world), "p")
