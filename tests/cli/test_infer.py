"""`orbisim infer` writes a recording that binds to the scene."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from orbisim.cli.main import run
from orbisim.recording import Recording, bind
from tests.backends.diffusion.tiny import ARM, add_inference, arm, save_tiny


def test_the_command_writes_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = add_inference(save_tiny(tmp_path / "tiny", arm()))
    (tmp_path / "scene.xml").write_text(ARM)
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (5, 64, 96, 3), np.uint8)
    iio.imwrite(tmp_path / "video.mp4", frames, plugin="FFMPEG", fps=20, macro_block_size=2)
    command = ["infer", str(tmp_path / "video.mp4"), "--scene", str(tmp_path / "scene.xml")]
    options = ["--checkpoint", str(folder), "--out", str(tmp_path / "rec.npz"), "--json"]
    assert run([*command, *options]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["signals"] == ["qpos/reach", "qpos/swing", "xpos/cube", "xquat/cube"]
    recording = Recording.load(tmp_path / "rec.npz")
    np.testing.assert_allclose(recording.time, np.arange(5) / 20)
    assert bind(recording, arm()).qpos.shape == (5, 9)
