"""Own recordings: a folder with scene, states, calibration and images, up to a checkpoint."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import torch
from orbisim_diffusion.checkpoint import load_checkpoint
from orbisim_diffusion.own import read_own, squares

from orbisim.cli.main import run
from orbisim.errors import InputError
from orbisim.recording import Recording
from tests.backends.diffusion.tiny import ARM, arm


def write_own(folder: Path, frames: int = 6, fps: float = 10.0) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "scene.xml").write_text(ARM)
    time = np.linspace(0.0, 2.0, 41)
    qpos = np.tile(arm().model.qpos0, (41, 1))
    qpos[:, 0] = 0.3 * time
    Recording(time, {"qpos": qpos}).save(folder / "recording.npz")
    camera = {
        "pos": [0.5, -1.0, 0.6],
        "rot": [[1, 0, 0], [0, 0.5, -0.8660254], [0, 0.8660254, 0.5]],
        "intrinsics": [[60, 0, 32], [0, 60, 24], [0, 0, 1]],
        "fps": fps,
        "start": 0.5,
    }
    (folder / "camera.json").write_text(json.dumps(camera))
    (folder / "images").mkdir(exist_ok=True)
    for i in range(frames):
        iio.imwrite(folder / "images" / f"{i:03d}.png", np.full((48, 64, 3), 40 * i, np.uint8))
    return folder


def test_states_are_those_of_the_images_times(tmp_path: Path) -> None:
    found = read_own(write_own(tmp_path / "a"), 32)
    assert found["frames"].shape == (6, 32, 32, 3)
    np.testing.assert_allclose(found["frames"].mean((1, 2, 3)), 40.0 * np.arange(6), atol=1)
    lower = found["pos"][:, 2]  # it swings with the first joint, 0.03 rad a frame from 0.15 on
    assert np.linalg.norm(lower[1] - lower[0]) == pytest.approx(0.03 * 0.25, rel=0.1)
    # the middle square of 64 x 48 has the same focal length in pixels and its own centre
    np.testing.assert_allclose(found["lens"], [60 / 48, 60 / 48, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("rot", [[1, 0], [0, 1]], "rot must be finite numbers of shape"),
        ("pos", None, "pos must be finite"),
        ("start", 1.9, "the video runs from 1.9"),
        ("fps", "fast", "fps must be a number"),
        ("rot", [[2, 0, 0], [0, 2, 0], [0, 0, 2]], "orthonormal"),
    ],
)
def test_calibrations_that_make_no_sense(
    tmp_path: Path, name: str, value: object, says: str
) -> None:
    folder = write_own(tmp_path / "a")
    camera = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps({**camera, name: value}))
    with pytest.raises(InputError, match=says):
        read_own(folder, 32)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none of scene\.xml"):
        read_own(tmp_path, 32)
    folder = write_own(tmp_path / "a", frames=0)
    with pytest.raises(InputError, match="neither video"):
        read_own(folder, 32)


def test_middle_squares() -> None:
    wide = np.zeros((1, 4, 8, 3), np.uint8)
    wide[:, :, 2:6] = 255
    assert squares(wide, 4).min() == 255


def test_the_command_trains_on_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = write_own(tmp_path / "a"), tmp_path / "out"
    command = ["train", "vision", str(folder), "--config", "tiny", "--steps", "2", "--json"]
    options = ["--out", str(out), "--device", "cpu"]
    assert run([*command, *options]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["metrics"]["autoencoder"]["psnr"] > 0
    point = load_checkpoint(out)
    assert point.one_step is not None
    assert point.manifest["data"]["sources"][0]["task"] == "own recording"
    assert run([*command, *options]) == 2
    assert "--resume" in capsys.readouterr().err
    assert run([*command, *options, "--resume"]) == 0


def test_a_training_begins_from_a_checkpoint_and_leaves_parts_as_they_are(tmp_path: Path) -> None:
    folder, start, out = write_own(tmp_path / "a"), tmp_path / "start", tmp_path / "out"
    command = ["train", "vision", str(folder), "--steps", "2", "--device", "cpu"]
    assert (
        run([*command, "--out", str(out), "--shares", "0", "1", "0"]) == 2
    )  # nothing to begin from
    assert (
        run([*command, "--config", "tiny", "--out", str(start), "--shares", "0.5", "0.5", "0"]) == 0
    )
    more = ["--out", str(out), "--start", str(start), "--shares", "0", "0.8", "0.2"]
    assert run([*command, *more]) == 0
    old, new = load_checkpoint(start), load_checkpoint(out)
    assert new.config == old.config and new.one_step is not None
    same, other = old.autoencoder.state_dict(), new.autoencoder.state_dict()
    assert all(torch.equal(same[name], other[name]) for name in same)
    pairs = zip(old.denoiser.parameters(), new.denoiser.parameters(), strict=True)
    assert any(not torch.equal(a, b) for a, b in pairs)
