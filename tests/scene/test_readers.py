"""Readers by suffix and by root element."""

from __future__ import annotations

from typing import Any

import mujoco
import pytest

from orbisim import load_scene
from orbisim.errors import InputError, SceneError, UnknownNameError
from orbisim.scene import readers
from orbisim.scene.readers import reader_of_root, reader_of_suffix, register_reader, suffixes
from orbisim.scene.reading import Reader, ReadResult


class Toy(Reader):
    format = "Toy"
    suffix = ".toy"
    root = "toy"

    def read(self, path: str, **options: Any) -> ReadResult:
        spec = mujoco.MjSpec()
        spec.modelname = "toy"
        return ReadResult(spec)


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readers, "_registered", {})


def test_one_of_ones_own(tmp_path) -> None:
    register_reader(".toy", Toy)
    assert suffixes()[-1] == ".toy"
    assert isinstance(reader_of_suffix(".toy"), Toy)
    assert isinstance(reader_of_root("toy"), Toy)
    (tmp_path / "a.toy").write_text("<toy/>")
    assert load_scene(tmp_path / "a.toy").model.nbody == 1


def test_it_may_stand_in_for_a_known_one() -> None:
    register_reader(".urdf", Toy)
    assert isinstance(reader_of_suffix(".urdf"), Toy)
    assert suffixes().count(".urdf") == 1


@pytest.mark.parametrize(
    ("suffix", "format"), [(".xml", "MJCF"), (".mjcf", "MJCF"), (".urdf", "URDF"), (".usda", "USD")]
)
def test_those_that_come_along(suffix: str, format: str) -> None:
    assert reader_of_suffix(suffix).format == format


def test_roots() -> None:
    assert reader_of_root("mujoco").format == "MJCF"  # type: ignore[union-attr]
    assert reader_of_root("robot").format == "URDF"  # type: ignore[union-attr]
    assert reader_of_root("") is None
    assert reader_of_root("html") is None


@pytest.mark.parametrize(
    ("suffix", "reader", "message"),
    [
        ("toy", Toy, "starts with a dot; got 'toy'"),
        (".TOY", Toy, "in small letters"),
        (".toy", Toy(), "must be a subclass of Reader"),
        (".toy", dict, "must be a subclass of Reader"),
    ],
)
def test_what_cannot_be_registered(suffix: str, reader: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        register_reader(suffix, reader)
    assert suffixes().count(suffix) == 0


def test_a_suffix_without_reader(tmp_path) -> None:
    with pytest.raises(UnknownNameError, match=r"did you mean 'urdf'"):
        reader_of_suffix(".urdff")
    (tmp_path / "a.toy").write_text("anything")
    with pytest.raises((SceneError, InputError), match=r"\.toy"):
        load_scene(tmp_path / "a.toy")
