"""Scenes that tasks start from."""

from __future__ import annotations

import pytest

from orbisim.errors import InputError
from orbisim.tasks import assets


@pytest.mark.parametrize("name", ["push", "push_cubes", "pick_and_place", "ball", "toss", "drape"])
def test_each_compiles(name: str) -> None:
    assert assets.scene(assets.spec(name), "label").model.nv > 0


def test_a_copy_may_be_edited() -> None:
    spec = assets.spec("toss")
    before = spec.option.timestep
    spec.option.timestep = 0.5
    assert assets.spec("toss").option.timestep == before
    assert assets.scene(spec, "label").source == "label"


def test_one_that_is_not_installed() -> None:
    with pytest.raises(InputError, match="not installed completely"):
        assets.path("teapot")
