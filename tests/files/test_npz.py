"""`.npz` files that are not what they say."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from orbisim.errors import InputError
from orbisim.files import npz


def _npy(shape: str, data: bytes = b"", dtype: str = "<f8") -> bytes:
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"
    header = header.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + data


def _archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def test_arrays_come_back(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array("text"), "c": np.zeros((0, 4))}
    np.savez_compressed(path, **arrays)
    with npz.opened(path) as file:
        assert set(file) == set(arrays)
        for name, array in arrays.items():
            np.testing.assert_array_equal(file[name], array)
        assert "d" not in file
        with pytest.raises(KeyError):
            file["d"]


@pytest.mark.parametrize(
    ("member", "problem"),
    [
        (_npy("(1000000000,)"), "more than is there"),
        (_npy("(1000000, 1000000, 1000000)"), "more than is there"),
        (_npy("(-1,)"), "cannot be read"),
        (_npy("(1,)", bytes(16)), "followed by something else"),
        (_npy("(1,)", bytes(8), "|O"), "Python objects"),
        (_npy("(1,)", bytes(8), "<f9"), "cannot be read"),
        (b"", "cannot be read"),
        (b"\x93NUMPY\x09\x00", "cannot be read"),
    ],
)
def test_members_that_are_not_what_they_say(tmp_path: Path, member: bytes, problem: str) -> None:
    path = _archive(tmp_path / "a.npz", a=member)
    tracemalloc.start()
    with npz.opened(path) as file, pytest.raises(InputError, match=f"'a' .*{problem}"):
        file["a"]
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    zeros = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        zeros, {"descr": "<f8", "fortran_order": False, "shape": (2**26,)}
    )
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("a.npy", "w") as member,
    ):
        member.write(zeros.getvalue())
        for _ in range(2**26 * 8 // 2**20):
            member.write(bytes(2**20))
    with npz.opened(path) as file, pytest.raises(InputError, match="out of proportion"):
        file["a"]


@hypothesis.settings(max_examples=100, deadline=None)
@hypothesis.given(data=st.data())
def test_damaged_files_are_refused_or_read(data: st.DataObject, tmp_path_factory) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, a=np.arange(20.0), b=np.array("header"))
    damaged = bytearray(buffer.getvalue())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("npz") / "a.npz"
    path.write_bytes(damaged)
    try:
        with npz.opened(path) as file:
            for name in file:
                file[name]
    except InputError as error:
        assert "\n" not in str(error)
