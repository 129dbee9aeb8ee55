"""Videos."""

from __future__ import annotations

import base64
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from orbisim.errors import InputError, OutputError
from orbisim.report import video
from orbisim.report.video import data_uri, difference, frames_of, side_by_side, write_video
from orbisim.scene import Scene
from orbisim.state import State
from tests.test_renderer import Height


def grey(level: int, count: int = 6) -> list[np.ndarray]:
    return [np.full((16, 32, 3), level, np.uint8)] * count


def test_what_is_written_can_be_watched(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mp4", grey(40) + grey(200), 12)
    frames = iio.imread(tmp_path / "v.mp4", plugin="FFMPEG")
    assert frames.shape == (12, 16, 32, 3)
    np.testing.assert_allclose(frames[:6].mean(), 40, atol=6)
    np.testing.assert_allclose(frames[6:].mean(), 200, atol=6)
    assert iio.immeta(tmp_path / "v.mp4", plugin="FFMPEG")["fps"] == 12


def test_a_page_holds_the_same_video(tmp_path: Path) -> None:
    kind, _, encoded = data_uri(grey(90), 10).partition(",")
    assert kind == "data:video/mp4;base64"
    (tmp_path / "v.mp4").write_bytes(base64.b64decode(encoded))
    assert len(iio.imread(tmp_path / "v.mp4", plugin="FFMPEG")) == 6


def test_where_no_file_can_be(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone/v\.mp4: cannot be written"):
        write_video(tmp_path / "gone" / "v.mp4", grey(1), 10)


def test_half_a_video_is_never_under_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(path: Path, *_: object, **__: object) -> None:
        Path(path).write_bytes(b"half")
        raise OSError("ffmpeg died")

    monkeypatch.setattr(video.iio, "imwrite", broken)
    with pytest.raises(OutputError, match="ffmpeg died"):
        write_video(tmp_path / "v.mp4", grey(1), 10)
    assert not list(tmp_path.iterdir())


def test_side_by_side() -> None:
    (frame, *_) = side_by_side(grey(1), grey(9))
    assert frame.shape == (16, 32 + 4 + 32, 3)
    assert (frame[:, :32] == 1).all()
    assert (frame[:, 32:36] == 128).all()
    assert (frame[:, 36:] == 9).all()


def test_three_side_by_side() -> None:
    (frame, *_) = side_by_side(grey(1), grey(9), grey(5))
    assert frame.shape == (16, 3 * 32 + 2 * 4, 3)
    assert (frame[:, -32:] == 5).all()


def test_differences_are_shown_four_times_as_bright() -> None:
    assert (difference(grey(100), grey(110))[0] == 40).all()
    assert (difference(grey(110), grey(100))[0] == 40).all()
    assert (difference(grey(0), grey(200))[0] == 255).all()


class Painter(Height):
    def load(self, scene: Scene) -> None:
        pass


def test_frames_come_at_a_steady_rate_and_the_last_stays() -> None:
    time = np.linspace(0, 1, 101)
    qpos = time[:, None].copy()
    qpos[55:] = np.nan
    base = State(np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 0)))
    frames = frames_of(Painter(), time, qpos, base, 10.0, height=2)
    shown = [float(frame[0, 0]) for frame in frames]
    np.testing.assert_allclose(shown, [0, 0.1, 0.2, 0.3, 0.4, 0.5, *[0.5] * 5], atol=0.011)
