"""Rollouts: what each workflow sees, and the table of the command."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from orbisim_diffusion.checkpoint import load_checkpoint
from orbisim_diffusion.model import Painter
from orbisim_diffusion.workflows import rollout

from orbisim.cli.main import run
from orbisim.scene import visible
from tests.backends.diffusion.test_pretrained import write_lpips
from tests.backends.diffusion.tiny import arm, episode_of, save_tiny, store_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_tiny(tmp_path_factory.mktemp("tiny"), arm())


def test_workflows_see_what_they_should(folder: Path) -> None:
    painter = Painter.of(load_checkpoint(folder), torch.device("cpu"))
    store = store_of(arm(), frames=5, episodes=2)
    black = store.__class__(**{**vars(store), "frames": store.frames * 0})
    which = torch.arange(2)

    def images(source: object, workflow: str) -> np.ndarray:
        return rollout(painter, source, which, workflow, 3, 1).numpy()  # type: ignore[arg-type]

    assert images(store, "GT-state").shape == (2, 3, 32, 32, 3)
    assert np.any(images(store, "GT-state") != images(black, "GT-state"))
    for blind in ("Recon-first", "Recon-all"):  # they see no image
        np.testing.assert_array_equal(images(store, blind), images(black, blind))
    assert np.any(images(store, "Recon-first") != images(store, "Recon-all"))


def write_episodes(path: Path) -> Path:
    """An episode file with images, written by hand."""
    made = episode_of(arm(), 4)
    camera = {"frames/side": made["frames"], "cameras/side/pos": made["view_pos"]}
    arrays = {
        **camera,
        "cameras/side/rot": made["view_rot"],
        "descriptor/intrinsics/side": np.array([[38.4, 0, 16], [0, 38.4, 16], [0, 0, 1.0]]),
        "descriptor/geoms": made["geoms"],
        "descriptor/lights": made["lights"],
        "geoms/pos": made["pos"],
        "geoms/quat": made["quat"],
        "time": np.arange(4) * 0.05,
    }
    with h5py.File(path, "w") as file:
        file.attrs.update(schema="orbisim.episodes/1", task="task:push", seed=0, complete=True)
        file.attrs.update(control_timestep=0.05, timestep=0.002, config="{}", versions="{}")
        for name, values in arrays.items():
            file[f"episodes/000000/{name}"] = values
        columns = json.dumps(list(visible.COLUMNS))
        file["episodes/000000/descriptor/geoms"].attrs["columns"] = columns
    return path


def test_the_command_prints_a_table(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = write_episodes(tmp_path / "seen.h5")
    command = ["eval", "vision", str(folder), str(data), "--no-features", "--device", "cpu"]
    options = ["--workflow", "GT-state", "--steps", "1", "--steps", "2", "--horizon", "2"]
    assert run([*command, *options, "--json"]) == 0
    (table,) = json.loads(capsys.readouterr().out)["tables"]
    assert set(table["rows"]) == {"copy first frame", "GT-state, 1 steps", "GT-state, 2 steps"}
    assert table["rows"]["GT-state, 1 steps"]["PSNR2"] > 0
    write_lpips(tmp_path)
    assert run([*command, *options, "--weights", str(tmp_path), "--json"]) == 0
    (more,) = json.loads(capsys.readouterr().out)["tables"]
    assert all(np.isfinite(row["LPIPS2"]) and row["LPIPS2"] > 0 for row in more["rows"].values())
    assert more["rows"]["GT-state, 1 steps"]["PSNR2"] == table["rows"]["GT-state, 1 steps"]["PSNR2"]
    rows = []
    for seed in ("0", "1"):
        assert run([*command, *options, "--seed", seed, "--json"]) == 0
        rows.append(json.loads(capsys.readouterr().out)["tables"][0]["rows"]["GT-state, 2 steps"])
    assert rows[0] == table["rows"]["GT-state, 2 steps"] != rows[1]
    assert run([*command, *options]) == 0
    assert "PSNR2" in capsys.readouterr().out
