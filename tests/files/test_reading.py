"""Inputs: what they declare is checked first."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from orbisim.errors import InputError
from orbisim.files.reading import FREE, RATIO, Allowance, parse_json, read_bytes, read_json, size_of


def test_only_regular_files_of_a_size(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert size_of(path) == 5
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(InputError, match="has 5 bytes; at most 4 are read"):
        read_bytes(path, 4)
    os.mkfifo(tmp_path / "pipe")
    for name, problem in (("none", "no such file"), (".", "a folder"), ("pipe", "a pipe")):
        with pytest.raises(InputError, match=problem):
            size_of(tmp_path / name)
    with pytest.raises(InputError, match="a pipe or a device"):
        read_bytes("/dev/zero", 10)
    with pytest.raises(InputError, match="cannot be read"):
        size_of(tmp_path / ("n" * 300))


def test_a_sparse_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "sparse.json"
    with path.open("wb") as file:
        file.truncate(2**35)
    with pytest.raises(InputError, match=r"at most \d+ are read"):
        read_json(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"", "is not JSON"),
        (b"{", "is not JSON"),
        (b"[1]", "expected a JSON object; got list"),
        (b"\xff\xfe", "is not JSON"),
        (b'{"a": ' + b"1" * 5000 + b"}", "is not JSON"),
        (b'{"a": ' * 100_000, "nested too deeply"),
        (b"[" * 100_000, "nested too deeply"),
    ],
)
def test_what_is_no_json_object(text: bytes, problem: str) -> None:
    with pytest.raises(InputError, match=f"^x.json: .*{problem}"):
        parse_json(text, "x.json")


def test_json(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"a": 1}')
    assert read_json(tmp_path / "a.json") == {"a": 1}


def test_an_allowance_adds_up() -> None:
    allowance = Allowance("x.h5", 100)
    allowance.take(FREE, "a")
    with pytest.raises(InputError, match=r"x\.h5: b would bring .* out of proportion"):
        allowance.take(1, "b")
    Allowance("x.h5", FREE).take(RATIO * FREE, "a")
