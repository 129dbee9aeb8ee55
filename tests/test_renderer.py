"""What every renderer has without doing anything for it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from orbisim.errors import InputError
from orbisim.renderer import Renderer
from orbisim.scene import Scene
from orbisim.state import State


class Height(Renderer):
    """Paints the first coordinate of a world all over its image."""

    name = "height"
    modes = frozenset({"rgb", "depth"})

    def load(self, scene: Scene) -> None:
        raise AssertionError("not asked for")

    def render(self, state: State, *, world: int = 0, **options: Any) -> npt.NDArray[Any]:
        self.check_mode(options.get("mode", "rgb"))
        return np.full((options["height"], 3), state.qpos[world, 0])


def states(nworld: int) -> State:
    column = np.arange(nworld, dtype=float)[:, None]
    return State(time=np.zeros(nworld), qpos=column, qvel=column, act=np.zeros((nworld, 0)))


def test_a_batch_is_every_world_with_the_same_options() -> None:
    images = Height().render_batch(states(4), height=2, mode="depth")
    assert images.shape == (4, 2, 3)
    np.testing.assert_array_equal(images[:, 0, 0], [0, 1, 2, 3])


def test_modes_that_it_lacks_are_named_with_those_it_has() -> None:
    with pytest.raises(InputError, match="'height' has no mode 'segmentation'; it has depth, rgb"):
        Height().render_batch(states(1), height=2, mode="segmentation")
