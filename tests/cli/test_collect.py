"""`orbisim collect`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orbisim.cli.collect import _setting
from orbisim.cli.main import run
from orbisim.errors import InputError
from orbisim.tasks.dataset import EpisodeFile


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "ball.h5")
    arguments = ["collect", "ball", "--episodes", "3", "--workers", "1", "--seed", "5"]
    assert run([*arguments, "--set", "velocity_x=0.25", "--out", out, "--json"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert result["schema"] == "orbisim.collect/1"
    assert (result["episodes"], result["steps"]) == (3, 108)
    with EpisodeFile(out) as episodes:
        assert episodes.episode(0)["qvel"][0, 0] == 0.25
    assert run([*arguments, "--out", out]) == 2
    assert "already exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pusch"], "did you mean"),
        (["push", "--subtask", "to_hurt"], "did you mean 'to_hit'"),
        (["push", "--subtask", "three"], "say how many"),
        (["push", "--episodes", "0"], "at least one episode"),
        (["push", "--workers", "0"], "at least one worker"),
        (["push", "--seed", "-1"], "x>=0"),
        (["push", "--set", "friction=1"], "unknown setting"),
        (["push", "--set", "density=9,1"], "a range LOW,HIGH"),
        (["push", "--set", "density"], "NAME=NUMBER"),
        (["push", "--frames", "sied"], "did you mean 'side'"),
        (["push", "--frames", "side", "--size", "4"], "8 to 2048"),
        (["suite:cheetah-fly"], "unknown task"),
    ],
)
def test_wrong_input(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    assert run(["collect", *arguments, "--out", str(tmp_path / "x.h5")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err
    assert not list(tmp_path.iterdir())


def test_settings_are_numbers_or_ranges() -> None:
    assert _setting("density=400") == ("density", 400.0)
    assert _setting("x = 0.1,0.2") == ("x", (0.1, 0.2))
    for text in ("density", "density=", "density=heavy", "x=1,"):
        with pytest.raises(InputError, match="NAME=NUMBER or NAME=LOW,HIGH"):
            _setting(text)
