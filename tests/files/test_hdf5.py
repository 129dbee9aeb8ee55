"""HDF5 that leads elsewhere, or is not what it says."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbisim.errors import InputError
from orbisim.files.hdf5 import Reader

h5py = pytest.importorskip("h5py")


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file that a hostile one would like to be read."""
    path = tmp_path / "secret.h5"
    with h5py.File(path, "w") as file:
        file["numbers"] = np.arange(4.0)
    (tmp_path / "raw").write_bytes(np.arange(4.0).tobytes())
    return path


def _external(file: Any, secret: Path) -> None:
    file["x"] = h5py.ExternalLink(str(secret), "/numbers")


def _soft(file: Any, secret: Path) -> None:
    file["y"] = np.zeros(3)
    file["x"] = h5py.SoftLink("/y")


def _virtual(file: Any, secret: Path) -> None:
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource(secret, "numbers", (4,))
    file.create_virtual_dataset("x", layout)


def _stored_elsewhere(file: Any, secret: Path) -> None:
    raw = str(secret.with_name("raw"))
    file.create_dataset("x", (4,), "f8", external=[(raw, 0, 32)])


def _unknown_filter(file: Any, secret: Path) -> None:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((4,))
    plist.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (1,))
    space = h5py.h5s.create_simple((4,))
    h5py.h5d.create(file.id, b"x", h5py.h5t.IEEE_F64LE, space, plist)


def _objects(file: Any, secret: Path) -> None:
    file.create_dataset("x", (2,), h5py.string_dtype())


def _compound(file: Any, secret: Path) -> None:
    file["x"] = np.zeros(2, [("a", "f8"), ("b", "i4")])


def _huge(file: Any, secret: Path) -> None:
    file.create_dataset("x", (10**6, 10**6), "f8", chunks=(10, 10))


def _crumbs(file: Any, secret: Path) -> None:
    file.create_dataset("x", (10**7,), "f8", chunks=(8,))


def _bomb(file: Any, secret: Path) -> None:
    file.create_dataset("x", (2**17, 1024), "f8", chunks=(1024, 1024), compression="gzip")


def _axes(file: Any, secret: Path) -> None:
    file["x"] = np.zeros((1,) * 12)


def _group(file: Any, secret: Path) -> None:
    file.create_group("x")


def _empty(file: Any, secret: Path) -> None:
    file["x"] = h5py.Empty("f8")


REFUSED: dict[Callable[[Any, Path], None], str] = {
    _external: "a link to elsewhere",
    _soft: "a link to elsewhere",
    _virtual: "in another file",
    _stored_elsewhere: "in another file",
    _unknown_filter: "packed by filter 32015",
    _objects: "expected numbers or strings of fixed length",
    _compound: "expected numbers",
    _huge: "out of proportion",
    _crumbs: "chunks of a few bytes",
    _bomb: "out of proportion",
    _axes: "has 12 axes",
    _group: "expected a dataset",
    _empty: "expected numbers",
}


@pytest.mark.parametrize("make", REFUSED, ids=lambda make: make.__name__.strip("_"))
def test_what_is_refused(tmp_path: Path, secret: Path, make: Callable[[Any, Path], None]) -> None:
    path = tmp_path / "hostile.h5"
    with h5py.File(path, "w") as file:
        make(file, secret)
    with Reader(path) as reader, pytest.raises(InputError, match=REFUSED[make]) as caught:
        reader.array("x")
    assert str(caught.value).startswith(f"{path}: ")


def test_links_on_the_way_are_not_followed(tmp_path: Path, secret: Path) -> None:
    path = tmp_path / "hostile.h5"
    with h5py.File(path, "w") as file:
        file["group"] = h5py.ExternalLink(str(secret), "/")
    with Reader(path) as reader:
        for place in ("group/numbers", "group"):
            with pytest.raises(InputError, match="a link to elsewhere"):
                reader.array(place)
        with pytest.raises(InputError, match="a link to elsewhere"):
            reader.datasets()


def test_circles_end(tmp_path: Path) -> None:
    path = tmp_path / "circle.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("g")
        for name in "abcdef":
            group[name] = group
    with Reader(path) as reader, pytest.raises(InputError, match="more than 10000 names"):
        reader.datasets("g")


def test_many_links_to_one_dataset_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "many.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("0", (2**20, 8), "f8", chunks=(2**16, 8), compression="gzip")
        for number in range(1, 10):
            file[str(number)] = file["0"]
    with Reader(path) as reader:
        allowance = reader.allowance()
        with pytest.raises(InputError, match="out of proportion"):
            for name in reader.keys():  # noqa: SIM118 (no mapping)
                reader.array(name, allowance)


def test_what_is_read(tmp_path: Path) -> None:
    path = tmp_path / "fine.h5"
    with h5py.File(path, "w") as file:
        file["a/b/numbers"] = np.arange(3)
        file["a/names"] = np.array([b"x", b"y"])
        for packed in ("gzip", "lzf"):
            file.create_dataset(packed, data=np.ones((4, 4)), compression=packed, shuffle=True)
        file.attrs.update(
            text="t", raw=np.bytes_("r"), number=1.5, count=3, flag=True, json='{"a": 1}'
        )
        file.attrs["many"] = [1, 2]
    with Reader(path) as reader:
        assert reader.keys("a") == ["b", "names"]
        assert reader.datasets() == ["a/b/numbers", "a/names", "gzip", "lzf"]
        assert reader.datasets("a") == ["b/numbers", "names"]
        assert reader.array("a/b/numbers").tolist() == [0, 1, 2]
        assert reader.array("a/names").tolist() == [b"x", b"y"]
        assert (reader.array("gzip") == reader.array("lzf")).all()
        assert reader.shape("gzip") == (4, 4)
        assert (reader.text("", "text"), reader.text("", "raw")) == ("t", "r")
        assert (reader.number("", "number"), reader.integer("", "count")) == (1.5, 3)
        assert reader.attribute("", "flag") is True
        assert reader.attribute("", "none") is None
        assert reader.parsed("", "json") == {"a": 1}
        for ask in (
            lambda: reader.text("", "none"),
            lambda: reader.text("", "number"),
            lambda: reader.number("", "text"),
            lambda: reader.integer("", "number"),
            lambda: reader.attribute("", "many"),
            lambda: reader.parsed("", "text"),
            lambda: reader.array("a/none"),
            lambda: reader.keys("gzip"),
        ):
            with pytest.raises(InputError, match=str(path)):
                ask()


def test_what_is_no_hdf5(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("text")
    os.mkfifo(tmp_path / "pipe.h5")
    for name, problem in (
        ("none.h5", "no such file"),
        ("text.h5", "not an HDF5 file"),
        ("pipe.h5", "a pipe"),
        (".", "a folder"),
    ):
        with pytest.raises(InputError, match=problem):
            Reader(tmp_path / name)
