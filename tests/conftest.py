"""What all tests share."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from orbisim.host.progress import QUIET
from tests.disks import FULL_DISK, mounted

os.environ.setdefault(QUIET, "1")  # on a busy machine anything may take two seconds
pytest_plugins = ("tests.processor_times",)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is imported stays: looking through it for garbage, again and again, finds none."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture
def full_disk() -> Iterator[Path]:
    """A disk with hardly any room."""
    with mounted(f"size={FULL_DISK}") as folder:
        yield folder


@pytest.fixture
def read_only_disk() -> Iterator[Path]:
    """A disk that cannot be written to."""
    with mounted(f"size={FULL_DISK},ro") as folder:
        yield folder
