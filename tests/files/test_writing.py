"""Outputs: whole or not at all, and errors that name the file."""

from __future__ import annotations

import errno
import logging
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from orbisim.errors import InputError, OutputError
from orbisim.files.writing import (
    check_folder,
    check_place,
    make_folder,
    write_json,
    write_text,
    writing,
)
from tests.disks import FULL_DISK, disk


def test_the_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "out.txt"
    with writing(target) as part:
        part.write_text("half")
        assert not target.exists()
        assert part.name == target.name  # writers choose formats by suffix
    assert target.read_text() == "half"
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.txt"]


def test_what_stood_there_stays_if_the_work_fails(tmp_path: Path) -> None:
    target = tmp_path / "out.txt"
    target.write_text("before")
    with pytest.raises(ZeroDivisionError), writing(target) as part:
        part.write_text("half")
        _ = 1 / 0
    assert target.read_text() == "before"
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.txt"]


def test_a_replaced_file_is_told_of_and_keeps_its_permissions(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    target = tmp_path / "out.txt"
    with caplog.at_level(logging.INFO, "orbisim.files"):
        write_text(target, "one")
        assert not caplog.messages
        target.chmod(0o640)
        write_text(target, "two")
        assert caplog.messages == [f"{target}: replaced"]
        write_text(target, "three", announce=False)
        assert len(caplog.messages) == 1
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to(tmp_path / "there" / "file.txt")
    write_text(link, "text")
    assert link.is_symlink()
    assert (tmp_path / "there" / "file.txt").read_text() == "text"


def test_devices_are_written_to_as_they_are() -> None:
    write_text("/dev/null", "text")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_json_is_strict(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"b": 1})
    assert (tmp_path / "a.json").read_text() == '{\n "b": 1\n}\n'
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"b": float("nan")})
    assert (tmp_path / "a.json").read_text() == '{\n "b": 1\n}\n'


def test_wrong_places(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for place in ("none/x", "file/x", "folder", "n" * 300):
        with pytest.raises(InputError, match=f"{place}: cannot be written"):
            write_text(tmp_path / place, "text")
    with pytest.raises(InputError, match="cannot be written"):
        make_folder(tmp_path / "file" / "folder")
    assert make_folder(tmp_path / "a" / "b").is_dir()


def test_places_are_checked_without_touching_them(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    check_folder(tmp_path / "new" / "newer")
    check_place(tmp_path / "new.txt")
    check_place("/dev/null")
    with pytest.raises(InputError, match="is not a folder"):
        check_folder(tmp_path / "file" / "x")
    with pytest.raises(InputError, match="no folder"):
        check_place(tmp_path / "new" / "x.txt")
    with pytest.raises(InputError, match="is a folder"):
        check_place(tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("number", "kind", "status"),
    [(errno.ENOSPC, OutputError, 1), (errno.EROFS, InputError, 2), (errno.EIO, OutputError, 1)],
)
def test_errors_of_the_system(
    tmp_path: Path, number: int, kind: type[InputError], status: int
) -> None:
    with pytest.raises(kind, match=str(tmp_path / "x.npz")) as caught, writing(tmp_path / "x.npz"):
        raise OSError(number, os.strerror(number))
    assert caught.value.exit_status == status
    assert not list(tmp_path.iterdir())


@disk
def test_a_full_disk(full_disk: Path) -> None:
    for make in (
        lambda part: np.savez(part, a=np.zeros(FULL_DISK)),
        lambda part: part.write_bytes(b"0" * 2 * FULL_DISK),
        _hdf5,
        _safetensors,
    ):
        with pytest.raises(OutputError, match="the disk is full"), writing(full_disk / "x") as part:
            make(part)
        assert not list(full_disk.iterdir())


@disk
def test_a_read_only_disk(read_only_disk: Path) -> None:
    with pytest.raises(InputError, match="Read-only file system"):
        write_text(read_only_disk / "x", "text")
    with pytest.raises(InputError, match="cannot be written to"):
        check_folder(read_only_disk / "a" / "b")
    with pytest.raises(InputError, match="cannot be written to"):
        check_place(read_only_disk / "a")


def _hdf5(part: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(part, "w") as file:
        file["a"] = np.zeros(FULL_DISK)


def _safetensors(part: Path) -> None:
    torch = pytest.importorskip("torch")
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(FULL_DISK)}, str(part))


def test_what_a_killed_process_leaves_goes_with_the_next_file(tmp_path: Path) -> None:
    target = tmp_path / "out.txt"
    code = (
        "import os, signal\n"
        "from orbisim.files.writing import writing\n"
        f"with writing({str(target)!r}) as part:\n"
        "    part.write_text('half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    assert not target.exists()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".out.txt.part-")
    long_ago = time.time() - 60
    os.utime(left, (long_ago, long_ago))
    write_text(target, "whole")
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.txt"]
