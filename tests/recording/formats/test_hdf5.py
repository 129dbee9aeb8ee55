"""Logs in HDF5 that its library cannot get out of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orbisim import Recording
from orbisim.errors import RecordingError
from orbisim.recording.formats import hdf5

h5py = pytest.importorskip("h5py")


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(hdf5, "_SECONDS", 0.3)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"] = np.arange(5.0)
        file["qpos/a"] = np.zeros(5)
    return tmp_path / "log.h5"


def _endless(*_: object) -> None:
    while True:
        pass


def test_it_is_read(log: Path) -> None:
    assert len(Recording.load(log)) == 5


@pytest.mark.parametrize("method", ["attribute", "array"])
def test_a_library_that_goes_round_in_circles_is_ended(
    log: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    monkeypatch.setattr(hdf5.Reader, method, _endless)
    with pytest.raises(RecordingError, match=r"log\.h5: cannot be read as HDF5 \(.*took more than"):
        Recording.load(log)
