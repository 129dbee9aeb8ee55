"""`orbisim train dynamics` and `orbisim eval dynamics`, from collected episodes to a backend."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene, make_backend
from orbisim.cli.main import run
from orbisim.tasks.collect import collect
from tests.scene.urdf.urdf_text import two_links

ROOT = Path(__file__).parents[2]
TOY = ["--set", "model.width=32", "--set", "model.layers=1", "--device", "cpu"]


@pytest.fixture(scope="module")
def episodes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data") / "pendulum.h5"
    collect("suite:pendulum-swingup", path, episodes=10, workers=1, changes={"steps": 60})
    return path


@pytest.fixture(scope="module")
def checkpoint(episodes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("checkpoint")
    stages = ["--set", "train.stages=0.7x1x256,0.3x4x32ar", "--set", "train.rate=3e-3"]
    arguments = ["train", "dynamics", str(episodes), "--out", str(out), "--steps", "120"]
    assert run([*arguments, *stages, *TOY]) == 0
    return out


def test_a_training_leaves_a_checkpoint_card_and_curves(checkpoint: Path) -> None:
    names = {path.name for path in checkpoint.iterdir()}
    assert {"model.safetensors", "manifest.json", "card.md", "curves.png", "metrics.jsonl"} <= names
    manifest = json.loads((checkpoint / "manifest.json").read_text())
    assert manifest["control_timestep"] == pytest.approx(0.02)
    assert manifest["data"]["sources"][0]["task"] == "suite:pendulum-swingup"
    card = (checkpoint / "card.md").read_text()
    assert "suite:pendulum-swingup" in card
    assert "held-out episodes" in card
    assert not list(checkpoint.glob("*.p*kl")) and not list(checkpoint.glob("*.pt"))


def test_a_bad_model_is_warned_of(
    episodes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    # A step of this rate throws the weights far off, and nothing after it brings them back.
    stages = ["--set", "train.stages=1x1x8", "--set", "train.rate=10", "--steps", "2"]
    assert run(["train", "dynamics", str(episodes), "--out", str(out), *stages, *TOY]) == 0
    assert "worse than if everything went on at constant velocity" in capsys.readouterr().err


def test_a_training_keeps_its_time(episodes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    limit = ["--time-limit", "0.1", "--set", "train.stages=1x1x8"]
    assert run(["train", "dynamics", str(episodes), "--out", str(out), *limit, *TOY]) == 0
    manifest = json.loads((out / "manifest.json").read_text())
    assert list(manifest["metrics"]["model"]) == ["10"]
    assert manifest["metrics"]["horizons_left_out"] == [50, 100]
    assert "no time to measure 50, 100 control steps" in (out / "card.md").read_text()


def test_an_evaluation_names_errors_by_horizon(
    checkpoint: Path, episodes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "eval",
        "dynamics",
        str(checkpoint),
        str(episodes),
        "--horizon",
        "10",
        "--burn",
        "0",
    ]
    assert run([*arguments, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["schema"] == "orbisim.eval/1"
    models = result["groups"]["all"]
    ours = models["default"]["10"]["normalised"]["median"]
    assert ours < 0.5 * models["constant_velocity"]["10"]["normalised"]["median"]
    assert run([*arguments, "--by-group"]) == 0
    assert "smooth: median over episodes" in capsys.readouterr().out


def test_the_trained_checkpoint_is_a_backend(checkpoint: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = load_scene("suite:pendulum-swingup")
        backend = make_backend(f"learned:{checkpoint}", scene, device="cpu", native=False)
        classical = make_backend("mujoco", scene)
        start = classical.reset(1)
        controls = np.zeros((5, 1))
        ours = backend.rollout(start, controls).qpos
        theirs = classical.rollout(start, controls, nstep=1).qpos
    assert backend.timestep == pytest.approx(0.02)
    assert np.abs(ours - theirs).max() < 0.2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--config", "defualt"], "did you mean 'default'"),
        (["--set", "model.widht=3"], "did you mean 'model.width'"),
        (["--set", "model.width=wide"], "model.width is 'wide'"),
        (["--set", "width"], "expected NAME=VALUE"),
        (["--residual-on", "mujoco"], "--config hybrid"),
    ],
)
def test_wrong_settings_are_explained(
    arguments: list[str],
    words: str,
    episodes: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    base = ["train", "dynamics", str(episodes), "--out", str(tmp_path), "--steps", "1"]
    assert run([*base, *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_budget_is_needed(
    episodes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["train", "dynamics", str(episodes), "--out", str(tmp_path)]) == 2
    assert "budget" in capsys.readouterr().err


@pytest.mark.slow  # programs that train in further processes
def test_train_all_and_the_measurements_run_at_toy_size(episodes: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    for name in ("suite_pendulum_train", "suite_pendulum_test"):
        (data / f"{name}.h5").symlink_to(episodes)
    sizes = ["--set", "train.stages=1x1x8", "--set", "model.width=16", "--set", "model.heads=2"]
    options = ["--data", data, "--out", tmp_path / "out", "--work", tmp_path / "work"]
    budget = ["--time-limit", "60", "--steps", "2", "--device", "cpu", "--only", "pendulum"]
    for script, arguments in (
        ("train_all.py", [*options, *budget, *sizes]),
        ("eval_dynamics.py", ["--zoo", tmp_path / "work", "--data", data, "--only", "errors"]),
    ):
        command = [sys.executable, ROOT / "tools" / script, *arguments]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "out" / "checkpoints-0.tar").stat().st_size < 15e6
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["pendulum"]["metrics"]["model"]


@pytest.mark.slow
def test_a_cloth_by_commands_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = str(tmp_path / "drape.h5"), str(tmp_path / "checkpoint")
    assert run(["collect", "task:drape", "--episodes", "2", "--workers", "1", "--out", data]) == 0
    sizes = ["--steps", "2", "--set", "train.stages=1x2x2", "--set", "model.width=16"]
    made = ["--config", "cloth", "--held-out", "0.5", "--device", "cpu"]
    assert run(["train", "dynamics", data, "--out", out, *made, *sizes]) == 0
    capsys.readouterr()
    assert run(["eval", "dynamics", out, data, "--by-group", "--horizon", "10", "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    for models in groups.values():
        assert models.keys() == {"cloth", "copy", "constant_velocity", "known"}
        errors = {name: m["10"]["vertex_position"]["mean"] for name, m in models.items()}
        assert errors["known"] < errors["constant_velocity"]
    assert run(["eval", "dynamics", out, data, "--horizon", "10"]) == 0
    assert "vertex_position" in capsys.readouterr().out
    simulated = ["--backend", f"learned:{out}", "--duration", "0.2", "--json"]
    assert run(["sim", "task:drape", *simulated]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == 10


@pytest.mark.slow
def test_a_robot_of_ones_own_by_commands_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limit = "<limit effort='5' velocity='2' lower='-1' upper='1'/>"
    (tmp_path / "robot.urdf").write_text(two_links("<axis xyz='0 1 0'/>", limit))
    robot = [str(tmp_path / "robot.urdf"), "--actuators", "motor"]
    data, out = str(tmp_path / "robot.h5"), str(tmp_path / "checkpoint")
    collected = ["--episodes", "12", "--set", "steps=60", "--workers", "1", "--randomize", "20"]
    assert run(["collect", *robot, *collected, "--out", data]) == 0
    sizes = ["--steps", "20", "--set", "train.stages=1x1x64", *TOY]
    assert run(["train", "dynamics", data, "--scene", *robot, "--out", out, *sizes]) == 0
    capsys.readouterr()
    simulated = ["--controls", "random", "--duration", "0.4", "--json"]
    assert run(["sim", *robot, "--backend", f"learned:{out}", *simulated]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == 20
    measured = ["eval", "dynamics", out, data, "--horizon", "5"]
    assert run([*measured, "--json"]) == 2
    assert "give the scene with --scene" in capsys.readouterr().err
    assert run([*measured, "--scene", *robot, "--json"]) == 0
    assert "constant_velocity" in json.loads(capsys.readouterr().out)["groups"]["all"]
