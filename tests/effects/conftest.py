"""What the tests of effects share."""

from __future__ import annotations

import pytest

from orbisim import Scene, load_scene

from .arm import ARM
from .motion import Motion, random_motion


@pytest.fixture(scope="session")
def scene() -> Scene:
    return load_scene(ARM)


@pytest.fixture(scope="session")
def motion(scene: Scene) -> Motion:
    return random_motion(scene.model)
