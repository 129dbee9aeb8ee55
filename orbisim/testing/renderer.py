"""What every renderer must do."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

from orbisim.errors import InputError, RenderingUnavailableError
from orbisim.physics import Physics
from orbisim.registry import available_renderers, make_backend, make_renderer
from orbisim.renderer import MODES, Renderer
from orbisim.scene import Scene, load_scene
from orbisim.state import State
from orbisim.testing import scenes


class RendererConformance:
    """Inherit, set `renderer`, run with pytest. Skips where the machine cannot render.

    Attributes:
      renderer: the registered name, with an argument if it takes one.
      config: further arguments for `make_renderer`.
      scene: the scene to test on.
      faithful: whether images show the scene's geometry and colours (tests them if so).
      tolerance: by how many grey levels two images of the same state may differ.
    """

    renderer: str = ""
    config: dict[str, Any] = {}  # noqa: RUF012 (overridden, not mutated)
    scene: str = scenes.COLOURS
    faithful: bool = True
    tolerance: float = 0.0

    @pytest.fixture(scope="class")
    @classmethod
    def loaded(cls) -> Scene:
        """The scene."""
        return load_scene(cls.scene)

    @pytest.fixture(scope="class")
    @classmethod
    def painter(cls, loaded: Scene) -> Renderer:
        """The renderer under test."""
        try:
            painter = make_renderer(cls.renderer, loaded, **cls.config)
            painter.render(cls.state(loaded), height=16, width=16)
        except RenderingUnavailableError as error:
            pytest.skip(str(error))
        return painter

    @staticmethod
    def state(scene: Scene, shift: float = 0.0, nworld: int = 2) -> State:
        """An initial state with the first coordinate moved in the second world."""
        state = make_backend("mujoco", scene).reset(nworld)
        qpos = np.array(state.qpos)
        qpos[1:, 0] += shift
        return state.replace(qpos=qpos)

    def test_is_registered(self) -> None:
        assert self.renderer.partition(":")[0] in available_renderers()

    def test_shapes_and_types(self, painter: Renderer, loaded: Scene) -> None:
        expected = {
            "rgb": ((24, 32, 3), np.uint8),
            "depth": ((24, 32), np.float32),
            "segmentation": ((24, 32, 2), np.int32),
        }
        for mode in MODES:
            if mode in painter.modes:
                image = painter.render(self.state(loaded), height=24, width=32, mode=mode)
                assert (image.shape, image.dtype.type) == expected[mode], mode

    def test_missing_modes_are_refused(self, painter: Renderer, loaded: Scene) -> None:
        for mode in (*(m for m in MODES if m not in painter.modes), "infrared"):
            with pytest.raises(InputError, match="mode"):
                painter.render(self.state(loaded), mode=mode)  # type: ignore[arg-type]

    def test_the_same_state_gives_the_same_image(self, painter: Renderer, loaded: Scene) -> None:
        state = self.state(loaded)
        first = painter.render(state, height=32, width=32).astype(float)
        again = painter.render(state, height=32, width=32).astype(float)
        assert np.abs(first - again).max() <= self.tolerance

    def test_a_batch_is_the_worlds(self, painter: Renderer, loaded: Scene) -> None:
        state = self.state(loaded, shift=0.5)
        batch = painter.render_batch(state, height=16, width=16)
        assert batch.shape[:1] == (2,)
        for world in range(2):
            single = painter.render(state, world=world, height=16, width=16)
            assert np.abs(batch[world].astype(float) - single).max() <= self.tolerance

    def test_images_do_not_share_memory(self, painter: Renderer, loaded: Scene) -> None:
        first = painter.render(self.state(loaded), height=16, width=16)
        kept = first.copy()
        painter.render(self.state(loaded, shift=0.5), world=1, height=16, width=16)
        np.testing.assert_array_equal(first, kept)

    def test_inside_physics(self, painter: Renderer, loaded: Scene) -> None:
        physics = Physics.from_scene(loaded)
        physics.use_renderer(self.renderer, **self.config)
        assert physics.render(16, 24).shape == (16, 24, 3)
        physics.step()
        assert physics.render(16, 24).shape == (16, 24, 3)

    # -- faithful renderers --------------------------------------------------------------------

    def needs_faithful(self) -> None:
        """Skips the test for renderers that do not show the scene."""
        if not self.faithful:
            pytest.skip("not a faithful renderer")

    def test_colours_are_where_the_objects_are(self, painter: Renderer, loaded: Scene) -> None:
        self.needs_faithful()
        image = painter.render(self.state(loaded), camera="front", height=65, width=65)
        assert _colour(image[32, 32]) == "red"
        assert _colour(image[5, 5]) == "blue"

    def test_moving_the_object_moves_the_image(self, painter: Renderer, loaded: Scene) -> None:
        self.needs_faithful()
        state = self.state(loaded, shift=0.5)
        image = painter.render(state, world=1, camera="front", height=65, width=65)
        assert _colour(image[32, 32]) == "blue"
        assert _colour(image[32, 51]) == "red"  # 0.5 m to the right at 2 m: 19 of 65 pixels

    def test_depth_is_in_metres(self, painter: Renderer, loaded: Scene) -> None:
        self.needs_faithful()
        if "depth" not in painter.modes:
            pytest.skip("no depth")
        depth = painter.render(
            self.state(loaded), camera="front", height=65, width=65, mode="depth"
        )
        assert depth[32, 32] == pytest.approx(1.7, abs=0.01)
        assert depth[5, 5] == pytest.approx(3.0, abs=0.02)

    def test_segmentation_names_the_geoms(self, painter: Renderer, loaded: Scene) -> None:
        self.needs_faithful()
        if "segmentation" not in painter.modes:
            pytest.skip("no segmentation")
        labels = painter.render(
            self.state(loaded), camera="front", height=65, width=65, mode="segmentation"
        )
        geom = int(mujoco.mjtObj.mjOBJ_GEOM)
        assert tuple(labels[32, 32]) == (loaded.model.geom("ball").id, geom)
        assert tuple(labels[5, 5]) == (loaded.model.geom("wall").id, geom)

    def test_wrong_cameras_and_worlds_are_refused(self, painter: Renderer, loaded: Scene) -> None:
        self.needs_faithful()
        for wrong in ({"camera": "no such camera"}, {"camera": 99}, {"world": 7}):
            with pytest.raises(InputError):
                painter.render(self.state(loaded), **wrong)


def _colour(pixel: npt.NDArray[np.uint8]) -> str:
    return ("red", "green", "blue")[int(np.argmax(pixel))]
