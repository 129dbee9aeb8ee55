"""StaInf becomes a part of the checkpoint whose encoder it reads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from orbisim_diffusion.checkpoint import AUTOENCODER, add_part, load_checkpoint
from orbisim_diffusion.estimate import load_inference
from orbisim_diffusion.train_inference import tune
from orbisim_diffusion.training import Run

from orbisim.cli.main import run
from orbisim.errors import InputError
from orbisim.tasks.collect import collect
from orbisim.tasks.frames import Camera
from orbisim.tasks.registry import make
from tests.backends.diffusion.tiny import save_tiny


@pytest.mark.slow
def test_the_command_adds_it_and_a_training_keeps_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, folder = tmp_path / "push.h5", save_tiny(tmp_path / "look", make("push").scene())
    collect("push", data, episodes=1, workers=1, camera=Camera("side", 32, buffers=False))
    command = ["train", "inference", str(folder), str(data), "--steps", "2", "--device", "cpu"]
    assert run([*command, "--json"]) == 0
    metrics = json.loads(capsys.readouterr().out)["metrics"]
    assert metrics["object_position_mm"] > 0 and metrics["frames"] == 111
    point, before = load_inference(folder)
    assert point.manifest["metrics"]["inference"] == metrics
    assert run([*command, "--start", str(folder)]) == 0
    after = load_inference(folder)[1].state_dict()
    moved = [float((after[n] - v).abs().max()) for n, v in before.state_dict().items()]
    assert 0 < max(moved) < 0.05  # two steps from where it was
    other = save_tiny(tmp_path / "other", make("push").scene())
    encoder = load_checkpoint(other).autoencoder
    next(encoder.parameters()).add_(0.1)
    add_part(other, AUTOENCODER, encoder, {})
    with pytest.raises(InputError, match="another encoder"):
        tune(other, [data], [], Run(1.0, 1), start=folder)
    more = ["train", "vision", str(data), "--start", str(folder), "--out", str(tmp_path / "more")]
    options = ["--shares", "0", "1", "0", "--steps", "1", "--device", "cpu"]
    assert run([*more, *options]) == 0
    load_inference(tmp_path / "more")
    evaluation = ["eval", "vision", str(tmp_path / "more"), str(data), "--no-features", "--mujoco"]
    evaluation += ["--predictions", str(tmp_path / "predictions.npz")]
    less = ["--workflow", "Recon-first", "--horizon", "2", "--device", "cpu", "--json"]
    capsys.readouterr()
    assert run([*evaluation, *less]) == 0
    rows = json.loads(capsys.readouterr().out)["tables"][0]["rows"]
    assert rows["MuJoCo of predicted states"]["PSNR2"] > rows["Recon-first, 1 steps"]["PSNR2"]
    assert rows["true video"]["TrajErr"] > 0 and rows["true video"]["SSIM2"] == 1.0
    assert run([*evaluation, *less]) == 0  # from the file
    assert json.loads(capsys.readouterr().out)["tables"][0]["rows"] == rows
