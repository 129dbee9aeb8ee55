"""Which reader reads what, and readers of third parties."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from orbisim import Recording, plugins
from orbisim.errors import InputError, MissingDependencyError, RecordingError
from orbisim.recording.formats.log import Column, Log
from orbisim.recording.formats.registry import open_log


class Counter:
    """A format of a third party: as many samples as the file has bytes."""

    def read(self, path: Path, part: str) -> Log:
        size = path.stat().st_size
        if size > 5:
            raise InputError(f"{path}: is too long")
        if size > 4:
            raise ModuleNotFoundError("No module named 'counting'", name="counting")
        columns = (Column("t", unit="ms"), Column("n", signal="ctrl/motor"))
        return Log(str(path), columns, lambda wanted: {n: np.arange(float(size)) for n in wanted})


@pytest.fixture
def counting(monkeypatch: pytest.MonkeyPatch) -> None:
    load = plugins.load
    monkeypatch.setattr(plugins, "names", lambda group: ("csv", "count"))
    monkeypatch.setattr(
        plugins, "load", lambda g, name, kind: Counter if name == "count" else load(g, name, kind)
    )


@pytest.mark.usefixtures("counting")
def test_a_format_of_a_third_party(tmp_path: Path) -> None:
    path = tmp_path / "a.count"
    path.write_bytes(b"1234")
    recording = Recording.load(path)
    np.testing.assert_array_equal(recording.time, [0, 0.001, 0.002, 0.003])
    np.testing.assert_array_equal(recording["ctrl/motor"], [0, 1, 2, 3])
    path.write_bytes(b"12345")
    with pytest.raises(MissingDependencyError, match=r"no module 'counting'.*orbisim\[logs\]"):
        Recording.load(path)
    path.write_bytes(b"123456")
    with pytest.raises(RecordingError, match="is too long"):
        Recording.load(path)


@pytest.mark.parametrize(
    ("name", "said", "module"),
    [("a.bag", "ROS bags", "rosbags"), ("a.mcap", "MCAP files", "mcap")],
)
def test_what_to_install_for_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, said: str, module: str
) -> None:
    (tmp_path / name).write_bytes(b"not looked at")
    for known in [n for n in sys.modules if n.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, known)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=rf"{said}.*{name}.*orbisim\[logs\]"):
        open_log(tmp_path / name)


def test_parts_are_for_folders(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time\n0\n1\n")
    with pytest.raises(RecordingError, match="is one episode; #3 is for folders"):
        open_log(f"{tmp_path / 'a.csv'}#3")
    (tmp_path / "a#3.csv").write_text("time\n0\n1\n")
    assert open_log(tmp_path / "a#3.csv").names == ("time",)


@pytest.mark.parametrize("name", ["a\0b.csv", "x" * 5000 + ".csv"])
def test_names_that_no_system_takes(name: str) -> None:
    with pytest.raises(RecordingError):
        open_log(name)


def test_every_format_is_registered() -> None:
    known = plugins.names("orbisim.recordings")
    assert {"npz", "csv", "parquet", "h5", "hdf5", "bag", "db3", "mcap"} <= set(known)
    assert {"metadata.yaml", "meta/info.json"} <= set(known)
    for name in known:
        assert hasattr(plugins.load("orbisim.recordings", name, "kind of recording"), "read")
