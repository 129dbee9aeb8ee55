"""Episodes written such that equal ones give equal bytes."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from orbisim.errors import InputError, OutputError
from orbisim.tasks import storage
from orbisim.tasks.episode import Episode
from orbisim.tasks.storage import assemble, check_destination, versions, write_episodes


def episode(seed: int, success: bool | None = None) -> Episode:
    arrays = {"time": np.arange(3.0), "descriptor/world": np.ones(2), "qpos": np.full((3, 1), seed)}
    arrays["frames/eye"] = np.zeros((3, 8, 8, 3), np.uint8)
    return Episode("throw", seed, "hash", arrays, {"descriptor/world": ("a", "b")}, success)


def test_what_is_written_is_there(tmp_path: Path) -> None:
    write_episodes(tmp_path / "a.h5", [(7, episode(3)), (8, episode(4, True))])
    with h5py.File(tmp_path / "a.h5") as file:
        assert list(file) == ["000007", "000008"]
        one = file["000007"]
        assert dict(one.attrs) == {
            "subtask": "throw",
            "seed": 3,
            "scene_hash": "hash",
            "success": -1,
        }
        assert file["000008"].attrs["success"] == 1
        np.testing.assert_array_equal(one["qpos"], np.full((3, 1), 3))
        assert one["descriptor/world"].attrs["columns"] == '["a", "b"]'
        assert one["frames/eye"].compression == "gzip"


def test_the_same_episodes_give_the_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        write_episodes(tmp_path / name, [(0, episode(3))])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_chunks_are_joined(tmp_path: Path) -> None:
    write_episodes(tmp_path / "a.h5", [(0, episode(3)), (1, episode(4))])
    write_episodes(tmp_path / "b.h5", [(2, episode(5))])
    whole = tmp_path / "whole.h5"
    assemble(whole, [tmp_path / "a.h5", tmp_path / "b.h5"], {"task": "task:ball", "seed": 1})
    with h5py.File(whole) as file:
        assert list(file["episodes"]) == ["000000", "000001", "000002"]
        assert file.attrs["complete"]
        assert (file.attrs["task"], file.attrs["schema"]) == ("task:ball", "orbisim.episodes/1")


def test_a_disk_without_room_is_noticed_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_episodes(tmp_path / "a.h5", [(0, episode(3))])
    room = storage.shutil._ntuple_diskusage(100, 90, 10)  # type: ignore[attr-defined]
    monkeypatch.setattr(storage.shutil, "disk_usage", lambda path: room)
    with pytest.raises(OutputError, match="the disk has 10 left"):
        assemble(tmp_path / "whole.h5", [tmp_path / "a.h5"], {})
    assert not (tmp_path / "whole.h5").exists()


def test_destinations(tmp_path: Path) -> None:
    check_destination(tmp_path / "new.h5")
    (tmp_path / "old.hdf5").touch()
    with pytest.raises(InputError, match="already exists"):
        check_destination(tmp_path / "old.hdf5")
    with pytest.raises(InputError, match=r"ends in \.h5"):
        check_destination(tmp_path / "new.npz")


def test_versions_are_those_installed() -> None:
    assert versions()["numpy"] == np.__version__
