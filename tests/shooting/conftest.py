"""What several of these tests fit."""

from pathlib import Path

import pytest

import orbisim


@pytest.fixture(scope="package")
def arm() -> orbisim.Scene:
    """The arm with two joints."""
    return orbisim.load_scene(Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml")
