"""`Renderer`: what turns a state into an image."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.scene import Scene
from orbisim.state import State

Mode = Literal["rgb", "depth", "segmentation"]
MODES: tuple[Mode, ...] = get_args(Mode)


class Renderer(abc.ABC):
    """Renders states of one scene.

    Attributes:
      name: the name under which the renderer is registered.
      modes: what it can render.
      memory: names in `State.memory` of what `observe` remembers.
    """

    name: ClassVar[str] = ""
    modes: frozenset[Mode] = frozenset({"rgb"})
    memory: ClassVar[frozenset[str]] = frozenset()

    @abc.abstractmethod
    def load(self, scene: Scene) -> None:
        """Prepares to render `scene`.

        Raises:
          RenderingUnavailableError: this machine cannot render.
          UnsupportedSceneError: the scene has something that this renderer cannot show.
        """

    @abc.abstractmethod
    def render(
        self,
        state: State,
        *,
        world: int = 0,
        camera: int | str = -1,
        height: int = 240,
        width: int = 320,
        mode: Mode = "rgb",
    ) -> npt.NDArray[Any]:
        """Renders one world.

        Args:
          state: the state; positions are all that matters to a classical renderer.
          world: which of its worlds.
          camera: name or number of a camera of the scene; -1 for the free camera.
          height: in pixels.
          width: in pixels.
          mode: `rgb` gives uint8 [height, width, 3]; `depth` float32 [height, width] in m;
            `segmentation` int32 [height, width, 2], (object id, `mujoco.mjtObj`), background
            (-1, -1).

        Raises:
          InputError: no such camera, world or mode.
        """

    def render_batch(self, state: State, **options: Any) -> npt.NDArray[Any]:
        """Renders every world: [nworld, height, width, ...]."""
        images = [self.render(state, world=world, **options) for world in range(state.nworld)]
        return np.stack(images)

    def observe(
        self, state: State, **options: Any
    ) -> tuple[npt.NDArray[Any], Mapping[str, npt.NDArray[Any]]]:
        """Every world's image, and what the next ones depend on beside their states.

        Renderers whose images continue earlier ones return it for `State.with_memory`; nothing is
        kept between calls.
        """
        return self.render_batch(state, **options), {}

    def check_mode(self, mode: str) -> None:
        """Raises `InputError` if this renderer does not have the mode."""
        if mode not in self.modes:
            raise InputError(
                f"renderer {self.name!r} has no mode {mode!r}; "
                f"it has {', '.join(sorted(self.modes))}"
            )

    def close(self) -> None:  # noqa: B027 (optional)
        """Frees what the renderer holds; it cannot be used afterwards."""


class NullRenderer(Renderer):
    """Renders nothing: blank images of the right shape, on machines that cannot render."""

    name = "null"
    modes = frozenset(MODES)

    def load(self, scene: Scene) -> None:
        """Accepts any scene."""

    def render(
        self,
        state: State,
        *,
        world: int = 0,
        camera: int | str = -1,
        height: int = 240,
        width: int = 320,
        mode: Mode = "rgb",
    ) -> npt.NDArray[Any]:
        """A black image, zero depth, or only background."""
        self.check_mode(mode)
        if mode == "depth":
            return np.zeros((height, width), np.float32)
        if mode == "segmentation":
            return np.full((height, width, 2), -1, np.int32)
        return np.zeros((height, width, 3), np.uint8)
