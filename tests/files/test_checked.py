"""What was checked once is known again: by content, in this process and in others."""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from pathlib import Path

import pytest

from orbisim.files import checked
from orbisim.files.checked import (
    cache_folder,
    digest_of,
    forget_all,
    key_of,
    recall,
    remember,
    sweep,
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    forget_all()
    found = cache_folder()
    assert found is not None
    return found


def settled(path: Path, data: bytes) -> Path:
    """A file that was written a while ago."""
    path.write_bytes(data)
    time.sleep(0.06)
    return path


def test_content_counts_not_names(tmp_path: Path) -> None:
    a, b = settled(tmp_path / "a", b"same"), settled(tmp_path / "b", b"same")
    assert digest_of(a) == digest_of(b)
    assert digest_of(settled(tmp_path / "c", b"other")) != digest_of(a)


def test_changes_are_seen_even_if_the_time_is_put_back(tmp_path: Path) -> None:
    path = settled(tmp_path / "a", b"first")
    before, times = digest_of(path), path.stat()
    path.write_bytes(b"secon")  # as long
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert digest_of(path) != before


def test_a_file_just_written_is_hashed_again(tmp_path: Path) -> None:
    """It may change once more within the same time stamp."""
    path = tmp_path / "a"
    path.write_bytes(b"first")
    digest_of(path)
    assert str(path) not in checked._digests
    time.sleep(0.06)
    digest_of(path)
    assert str(path) in checked._digests


def test_facts_outlive_the_process(folder: Path) -> None:
    key = key_of("mesh", ".obj", "00")
    assert recall(key) is None
    remember(key, {"several_objects": True})
    forget_all()
    assert recall(key) == {"several_objects": True}
    assert (folder / f"{key}.json").stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"[]", b"null", b'{"key": "another", "facts": {}}', b"\xff\xfe", b"[" * 10**5],
)
def test_what_is_broken_is_as_if_it_were_not_there(folder: Path, data: bytes) -> None:
    key = key_of("mesh", "x")
    (folder / f"{key}.json").write_bytes(data)
    assert recall(key) is None
    remember(key, {"a": 1})
    forget_all()
    assert recall(key) == {"a": 1}


def test_a_folder_that_others_may_write_is_not_used(folder: Path) -> None:
    key = key_of("mesh", "x")
    remember(key, {"a": 1})
    folder.chmod(0o777)
    forget_all()
    assert recall(key) is None
    folder.chmod(0o700)
    assert recall(key) == {"a": 1}


def test_without_a_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key = key_of("mesh", "x")
    monkeypatch.setenv("ORBISIM_NO_CACHE", "1")
    remember(key, {"a": 1})
    assert recall(key) == {"a": 1}  # in this process
    forget_all()
    assert recall(key) is None
    monkeypatch.delenv("ORBISIM_NO_CACHE")
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))  # no folder can be made there
    remember(key, {"a": 1})
    forget_all()
    assert recall(key) is None


def _write(number: int) -> None:
    for i in range(200):
        remember(key_of("mesh", str(i % 20)), {"writer": number, "text": "x" * 2000})


def test_many_writers(folder: Path) -> None:
    # a fork keeps the locks of threads that it does not have, and may wait for them for ever
    with multiprocessing.get_context("spawn").Pool(4) as pool:
        pool.map(_write, range(4))
    forget_all()
    for i in range(20):
        facts = recall(key_of("mesh", str(i)))
        assert facts is not None
        assert facts["writer"] in range(4)
    assert sorted(folder.glob(".*")) == []  # nothing half written is left


def test_old_entries_go(folder: Path) -> None:
    old, new = key_of("mesh", "old"), key_of("mesh", "new")
    remember(old, {}), remember(new, {})
    os.utime(folder / f"{old}.json", (0, 0))
    sweep(folder)
    assert [path.stem for path in folder.glob("*.json")] == [new]
    assert json.loads((folder / f"{new}.json").read_text())["key"] == new
