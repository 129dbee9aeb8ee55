"""Data that tests of several tools look at."""

from __future__ import annotations

import pytest
from orbisim_world_model.pack import Pack
from orbisim_world_model.packing import read_data

from orbisim.tasks.collect import collect


@pytest.fixture(scope="session")
def pushes(tmp_path_factory: pytest.TempPathFactory) -> Pack:
    """Two episodes of push."""
    path = tmp_path_factory.mktemp("push") / "push.h5"
    collect("push", path, episodes=2, seed=1, workers=1)
    return read_data([path])
