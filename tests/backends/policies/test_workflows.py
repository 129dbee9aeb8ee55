from __future__ import annotations

import json
from pathlib import Path

import pytest

from orbisim.cli.main import run

SHORT = ["--steps", "2", "--episode", "8", "--worlds", "2", "--check", "2", "--threads", "1"]


def test_from_a_training_to_an_evaluation_and_a_simulation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "p")
    task = ["suite:pendulum-swingup"]
    assert run(["train", "policy", *task, "--out", out, "--device", "cpu", *SHORT]) == 0
    said = capsys.readouterr().err
    assert "success_return" in said
    arguments = ["eval", "policy", out, "--episodes", "2", "--seed", "0", "--threads", "1"]
    assert run([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "orbisim.eval_policy/1" and {"mujoco", "model"} <= found.keys()
    assert found["method"] == "apg"
    assert run([*arguments, "--model", "none"]) == 0
    assert "return" in capsys.readouterr().out
    assert run([*arguments, "--observe", "stainf", "--model", "learned"]) == 2
    assert "no frames to read states off" in capsys.readouterr().err
    assert run(["sim", *task, "--policy", out, "--controls", "zero"]) == 2
    assert "exclude each other" in capsys.readouterr().err
    assert run(["sim", *task, "--policy", out, "--duration", "0.16", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == 8


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["push", "--method", "bc", "--backend", "learned"], "learns in mujoco"),
        (["push", "--method", "apg", "--backend", "mujoco"], "scenes of their own"),
        (["push", "--method", "bc", "--horizon", "4"], "--horizon means nothing"),
        (["suite:pendulum-swingup", "--method", "bc"], "no script"),
        (["push", "--method", "bc", "--start", "x"], "--start is for"),
        (["task:toss"], "task for policies"),
        (["push", "--method", "dreamer", "--horizon", "4"], "--horizon means nothing"),
    ],
)
def test_what_makes_no_sense_is_refused(
    arguments: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "p"), "--steps", "1", "--device", "cpu"]
    assert run(["train", "policy", *arguments, *out]) == 2
    assert text in capsys.readouterr().err
