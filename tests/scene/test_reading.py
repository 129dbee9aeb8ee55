"""What every reader is."""

from __future__ import annotations

import dataclasses

import mujoco
import pytest

from orbisim.errors import InputError
from orbisim.scene.reading import Reader, ReadResult, Unsupported


class FilesOnly(Reader):
    format = "Foo"
    suffix = ".foo"

    def read(self, path: str, **options: object) -> ReadResult:
        return ReadResult(mujoco.MjSpec())


def test_a_format_without_text_says_so() -> None:
    with pytest.raises(InputError, match="Foo is read from files only"):
        FilesOnly().read_string("text")


def test_a_reader_reads() -> None:
    with pytest.raises(TypeError, match="abstract"):
        Reader()  # type: ignore[abstract]
    assert not FilesOnly.isolated
    assert FilesOnly.root is None


def test_what_is_left_out_is_one_line_and_a_value() -> None:
    one = Unsupported("<gear>", "backlash", "ignored")
    assert str(one) == "<gear>: backlash (ignored)"
    assert one == Unsupported("<gear>", "backlash", "ignored")
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.element = "x"  # type: ignore[misc]
