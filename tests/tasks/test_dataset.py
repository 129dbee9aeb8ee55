"""Episodes read from their file."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from orbisim.errors import InputError
from orbisim.files.hdf5 import Reader
from orbisim.tasks import dataset
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("toss") / "toss.h5"
    collect("toss", path, episodes=40, seed=3, workers=1)
    return path


def test_reading(file: Path) -> None:
    with EpisodeFile(file) as episodes:
        assert len(episodes) == 40
        assert (episodes.task, episodes.seed) == ("task:toss", 3)
        assert episodes.control_timestep == pytest.approx(1 / 148)
        assert episodes.select("box") == list(range(20, 40))
        one = episodes.episode(0)
        assert one["qpos"].shape == (149, 7)
        assert one["ctrl"].shape == (148, 0)
        assert episodes.columns("descriptor/objects")[3] == "mass"
        assert episodes.entities(0) == ("box",)
        assert episodes.attributes(21)["subtask"] == "box"
        assert episodes.config["cube_half"] == [0.048, 0.056]
        stacked = episodes.stack(["objects/pos", "time"], [0, 30])
        np.testing.assert_array_equal(stacked.arrays["objects/pos"][0], one["objects/pos"])
        assert stacked.masks["objects/pos"].shape == (2, 149, 1)
        assert stacked.masks["time"].all()
        assert stacked.lengths.tolist() == [148, 148]
        with pytest.raises(InputError, match="has no 'episodes/000000/robot/pos'"):
            episodes.episode(0, ["robot/pos"])
        with pytest.raises(InputError, match="40 episodes"):
            episodes.episode(40)


def test_stacking_pads_episodes_with_fewer_objects(tmp_path: Path) -> None:
    path = tmp_path / "cubes.h5"
    collect("push_cubes", path, episodes=4, workers=1, subtask="random", seed=2)
    with EpisodeFile(path) as episodes:
        counts = [len(episodes.entities(i)) - 1 for i in range(4)]
        assert set(counts) == {3, 4}
        stacked = episodes.stack(["objects/pos", "descriptor/objects", "action"])
        assert stacked.arrays["objects/pos"].shape == (4, 161, 4, 3)
        np.testing.assert_array_equal(stacked.masks["objects/pos"][:, 0].sum(axis=1), counts)
        assert (stacked.arrays["objects/pos"][~stacked.masks["objects/pos"]] == 0).all()
        assert stacked.arrays["action"].shape == (4, 160, 7)


def test_reading_needs_neither_mujoco_nor_torch(file: Path) -> None:
    code = (
        "import sys; from orbisim.tasks import EpisodeFile\n"
        f"EpisodeFile({str(file)!r}).stack(['qpos'])\n"
        "bad = {'mujoco', 'torch', 'dm_control', 'scipy'} & set(sys.modules)\n"
        "assert not bad, bad\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("text")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other.attrs["schema"] = "other/1"
    with h5py.File(tmp_path / "half.h5", "w") as half:
        half.attrs["schema"] = "orbisim.episodes/1"
    for name, message in (
        ("none.h5", "no such file"),
        ("text.h5", "not an HDF5 file"),
        ("other.h5", "expected 'orbisim.episodes/1'"),
        ("half.h5", "not finished"),
    ):
        with pytest.raises(InputError, match=message):
            EpisodeFile(tmp_path / name)


def test_episodes_one_after_the_other(file: Path) -> None:
    with EpisodeFile(file) as episodes:
        first = next(iter(episodes))
        np.testing.assert_array_equal(first["qpos"], episodes.episode(-40)["qpos"])
        assert set(first) == set(episodes.names())
        assert episodes.lengths() == [148] * 40


def test_rows_must_be_as_many_as_the_steps(file: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(file.read_bytes())
    with h5py.File(damaged, "r+") as writable:
        group = writable["episodes/000000"]
        short = group["qpos"][:100]
        del group["qpos"]
        group["qpos"] = short
    with EpisodeFile(damaged) as episodes:
        with pytest.raises(InputError, match=r"qpos has shape \(100, 7\).* has 149 rows"):
            episodes.episode(0)
        assert episodes.episode(1)["qpos"].shape == (149, 7)


def _round_and_round(*_: object) -> None:
    while True:
        pass


@pytest.mark.parametrize("method", ["array", "attribute", "datasets"])
def test_a_library_that_goes_round_in_circles_is_ended(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    other = tmp_path / "other.h5"
    other.write_bytes(file.read_bytes())
    with h5py.File(other, "r+") as writable:  # of a content that never came through
        writable.attrs["other"] = f"{method} {time.time_ns()}"
    monkeypatch.setattr(dataset, "_SECONDS", -0.9)  # and 1.1 for the file's size
    monkeypatch.setattr(Reader, method, _round_and_round)
    with pytest.raises(InputError, match=r"other\.h5: cannot be read as HDF5 \(.*took more than"):
        EpisodeFile(other)


def test_what_came_through_is_not_tried_again(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    EpisodeFile(file).close()
    monkeypatch.delattr("orbisim.tasks.dataset.try_out")
    EpisodeFile(file).close()
