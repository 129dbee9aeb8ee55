"""Unfinished collections: damaged parts are made anew, half ones are never there."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any

import pytest

from orbisim.errors import InputError, OutputError
from orbisim.files import writing
from orbisim.tasks import chunks, collect
from orbisim.tasks.collect import collect as collected
from orbisim.tasks.orders import Order
from tests.disks import disk

pytest.importorskip("h5py")


def order(count: int = 40) -> Order:
    return Order("task:toss", {}, 3, None, tuple(("box", i) for i in range(count)))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("toss") / "toss.h5"
    collected("toss", path, episodes=40, seed=3, workers=1)
    return path.read_bytes()


def interrupted(path: Path, monkeypatch: pytest.MonkeyPatch, after: int = 2) -> Path:
    """The folder of a collection of which so many chunks were made."""
    made = chunks.make_chunk

    class Interrupted(Exception):
        pass

    def make(*given: Any) -> None:
        if len(list(given[2].glob("chunk-*.h5"))) == after:
            raise Interrupted
        made(*given)

    with monkeypatch.context() as patch, pytest.raises(Interrupted):
        patch.setattr(chunks, "make_chunk", make)
        collected("toss", path, episodes=40, seed=3, workers=1)
    return path.with_name(path.name + ".partial")


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-1000]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(bytes(path.stat().st_size)),
        lambda path: path.write_bytes(path.read_bytes()[:-9] + b"x" * 9),
        lambda path: path.unlink(),
        lambda path: path.rename(path.with_name("chunk-000000.h5")),
    ],
)
def test_a_damaged_chunk_is_made_anew(
    tmp_path: Path, whole: bytes, damage: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "toss.h5"
    folder = interrupted(out, monkeypatch)
    first = min(folder.glob("chunk-*.h5"))
    damage(first)
    result = collected("toss", out, episodes=40, seed=3, workers=1)
    assert out.read_bytes() == whole
    assert result.resumed == 16
    assert not folder.exists()


def test_a_damaged_chunk_is_set_aside(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    chunks.prepare(tmp_path, order())
    chunks.make_chunk(order(), range(16), tmp_path)
    found = chunks.finished(tmp_path, range(16))
    assert found is not None
    assert chunks.finished(tmp_path, range(16, 32)) is None
    found.write_bytes(b"damaged")
    with caplog.at_level(logging.WARNING):
        assert chunks.finished(tmp_path, range(16)) is None
    assert "is damaged; its episodes are collected anew" in caplog.text
    assert found.with_name(found.name + ".damaged").read_bytes() == b"damaged"


def test_a_chunk_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Power that fails must not leave a name without its content."""
    seen: list[list[str]] = []

    def sync(handle: int) -> None:
        seen.append(sorted(path.name[:12] for path in tmp_path.glob("chunk-*.h5")))

    monkeypatch.setattr(writing.os, "fsync", sync)
    part = tmp_path / "part"
    part.write_bytes(b"content")
    chunks.keep(part, range(16), tmp_path)
    assert seen == [[], ["chunk-000000"]]  # the file; then the folder with its name


def test_a_half_label_does_not_block(tmp_path: Path) -> None:
    (tmp_path / ".order.part-x").mkdir()
    chunks.prepare(tmp_path, order())
    chunks.prepare(tmp_path, order())
    with pytest.raises(InputError, match="something else"):
        chunks.prepare(tmp_path, order(41))


def test_two_collections_do_not_share_a_file(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, begun, go_on = chunks.make_chunk, threading.Event(), threading.Event()

    def make(*given: Any) -> None:
        begun.set()
        go_on.wait(60)
        made(*given)

    monkeypatch.setattr(chunks, "make_chunk", make)
    out = tmp_path / "toss.h5"
    arguments = {"episodes": 40, "seed": 3, "workers": 1}
    first = threading.Thread(target=collected, args=("toss", out), kwargs=arguments)
    first.start()
    begun.wait(60)
    with pytest.raises(InputError, match="another collection is at work in it"):
        collected("toss", out, **arguments)
    go_on.set()
    first.join()
    assert out.read_bytes() == whole


@disk
@pytest.mark.parametrize("workers", [1, 2])
def test_a_full_disk_keeps_what_is_whole(full_disk: Path, workers: int) -> None:
    with pytest.raises(OutputError, match="the disk is full"):
        collected("toss", full_disk / "toss.h5", episodes=400, seed=3, workers=workers)
    assert not (full_disk / "toss.h5").exists()
    names = {path.name.split("-")[0] for path in (full_disk / "toss.h5.partial").iterdir()}
    # a worker that was stopped leaves its scratch folder, which the next collection removes
    assert names <= {"order", "chunk", ".chunk"}


@disk
def test_a_read_only_disk_is_noticed_before_the_work(
    read_only_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collect, "_make_missing", lambda *_: pytest.fail("began to work"))
    with pytest.raises(InputError, match="cannot be written to"):
        collected("toss", read_only_disk / "toss.h5", episodes=4)
