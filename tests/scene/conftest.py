"""What is known of checked files stays out of the user's own cache.

Of these tests alone: Warp and Matplotlib keep in the same place what takes them long to make.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator

import pytest

from orbisim.files.budget import Limits
from orbisim.scene import load


@pytest.fixture(autouse=True, scope="package")
def _cache_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["XDG_CACHE_HOME"]
    else:
        os.environ["XDG_CACHE_HOME"] = before


@pytest.fixture
def little_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes that would take for ever are stopped after a second of the processor, not four."""
    monkeypatch.setattr(load, "Limits", functools.partial(Limits, seconds=1.0))
