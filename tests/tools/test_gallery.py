"""tools/gallery.py: what stands on the page is what the tool makes."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from orbisim.cli.main import run
from tests.test_layers import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "tools"))

import gallery

PAGE = (REPOSITORY / "docs" / "gallery.md").read_text()


@pytest.mark.parametrize("name", gallery.PICTURES)
def test_each_picture_stands_with_its_commands(name: str) -> None:
    panels = gallery.PICTURES[name]
    assert f"(images/gallery/{name}.webp)" in PAGE
    assert all(panel.command in PAGE for panel in panels)
    with Image.open(gallery.OUT / f"{name}.webp") as picture:
        assert picture.n_frames > 10
        assert picture.width >= 120 * len(panels)
    assert (gallery.OUT / f"{name}.webp").stat().st_size <= gallery.MOST_BYTES


def test_there_are_no_others() -> None:
    shown = re.findall(r"\(images/gallery/(\w+)\.webp\)", PAGE)
    assert sorted(shown) == sorted(gallery.PICTURES)
    assert {path.stem for path in gallery.OUT.iterdir()} == set(shown)


@pytest.mark.parametrize("name", gallery.PICTURES)
def test_commands_have_options_that_there_are(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for panel in gallery.PICTURES[name]:
        program, *words = shlex.split(panel.command)
        assert program == "orbisim"
        assert run([*words, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


def test_panels_stand_side_by_side_and_the_shorter_stops() -> None:
    long = np.full((5, 40, 30, 3), 10, np.uint8)
    long[3:] = 200
    short = np.full((2, 40, 50, 3), 90, np.uint8)
    images = gallery.side_by_side([long, short], ["a", "b"])
    assert [image.size for image in images] == [(80, 40)] * 5
    last = np.asarray(images[-1])
    assert last[-1, 0, 0] == 200 and last[-1, -1, 0] == 90
    assert (last[:12, :15] != 200).any()  # its label


def test_a_picture_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.webp"
    frames = [Image.fromarray(np.full((8, 8, 3), value, np.uint8)) for value in (0, 99)]
    assert gallery.write(frames, path) == path.stat().st_size
    with Image.open(path) as picture:
        assert picture.n_frames == 2
    monkeypatch.setattr(gallery, "MOST_BYTES", 10)
    with pytest.raises(SystemExit, match="more than 10"):
        gallery.write(frames, path)
