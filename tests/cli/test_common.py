"""What the commands share."""

from __future__ import annotations

import contextlib
import io
import json
import logging
from pathlib import Path

import pytest

from orbisim.cli.common import (
    emit_json,
    note,
    notes_held_back,
    print_table,
    quiet_engine,
    torch_device,
)
from orbisim.cli.main import run
from orbisim.errors import InputError
from tests.scene.urdf.urdf_text import two_links


def test_json_has_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    nan, inf = float("nan"), float("inf")
    emit_json({"a": [1.5, nan, (inf, -inf)], "b": {"c": nan}, "d": True, "e": None})
    out = capsys.readouterr().out
    assert json.loads(out) == {
        "a": [1.5, None, [None, None]],
        "b": {"c": None},
        "d": True,
        "e": None,
    }
    assert "NaN" not in out


def test_notes_are_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    note("text")
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "text\n")


def test_a_table_shows_names_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("Title", ("name", "value"), [("[red]x[/red]", 0.123456), ("y", 10.0)])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].strip() == "Title"
    assert "[red]x[/red]" in lines[2]
    assert lines[2].rstrip().endswith("0.1235")
    assert lines[3].rstrip().endswith("10")
    assert len(lines[2].rstrip()) == len(lines[3].rstrip())  # numbers to the right


def test_tables_keep_long_cells_whole(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("", ("name",), [("n" * 150,)])
    assert "n" * 150 in capsys.readouterr().out


def test_a_narrow_terminal_cuts_no_number_in_two(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "60")
    values = [1.234e-07 * 10**i for i in range(5)]
    with contextlib.redirect_stdout(Terminal()) as terminal:
        print_table("", ("signal group", "unit", *"abcde"), [("joint_position", "rad/s", *values)])
    assert all(f"{value:.4g}" in terminal.getvalue() for value in values)


def test_the_engines_warnings_come_once(capsys: pytest.CaptureFixture[str]) -> None:
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    with quiet_engine():
        for _ in range(3):
            data = mujoco.MjData(model)
            data.qvel[0] = 1e12
            mujoco.mj_step(model, data)
    err = capsys.readouterr().err
    assert err.count("warning: ") == 1
    assert "QVEL" in err
    assert logging.getLogger("absl").level == logging.ERROR


LIMIT = "<limit effort='5' velocity='2' lower='-1' upper='1'/>"


def test_urdf_options_are_on_every_command_that_takes_a_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "meshes").mkdir()
    path = tmp_path / "robot.urdf"
    path.write_text(two_links(LIMIT))
    options = ["--actuators", "motor", "--floating-base", "--package", f"p={tmp_path / 'meshes'}"]
    assert run(["info", str(path), "--json", *options]) == 0
    found = json.loads(capsys.readouterr().out)
    kinds = [j["type"] for e in found["entities"] for p in e["parts"] for j in p["joints"]]
    assert len(found["actuators"]) == 1 and kinds == ["free", "hinge"]
    servo = [f"{path}?position_gain=30", "--json", "--actuators", "position"]
    assert run(["info", *servo]) == 0  # options behind the name stay
    assert json.loads(capsys.readouterr().out)["actuators"][0]["gainprm"][0] == 30
    simulated = ["sim", str(path), "--duration", "0.1", "--controls", "random"]
    assert run([*simulated, *options]) == 0
    assert "no actuators" not in capsys.readouterr().err
    assert run(simulated) == 0
    assert "no actuators, so controls do nothing; --actuators position" in capsys.readouterr().err
    collected = ["collect", str(path), "--episodes", "1", "--workers", "1", "--out"]
    assert run([*collected, str(tmp_path / "free.h5")]) == 0
    assert "no actuators, so its bodies were let go" in capsys.readouterr().err
    assert run([*collected, str(tmp_path / "driven.h5"), *options]) == 0
    assert "no actuators" not in capsys.readouterr().err
    for command in ("compare", "replay", "diagnose", "collect", "view", "infer"):
        assert run([command, "--help"]) == 0
        assert "--floating-base" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["info", "x.xml", "--floating-base"], "are for URDF; got x.xml"),
        (["info", "x.urdf", "--package", "p=/no/such"], "of a folder that is there"),
        (["info", "x.urdf", "--package", "p"], "--package is NAME=DIR"),
    ],
)
def test_urdf_options_that_make_no_sense(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments) == 2
    assert message in capsys.readouterr().err


def test_a_device_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [torch_device(name) for name in (None, "cpu", "cuda:0")] == ["cuda", "cpu", "cuda:0"]
    for name in ("cuda:1", "cuda:x", "tpu"):
        with pytest.raises(InputError, match=f"no device '{name}'"):
            torch_device(name)


def test_notes_about_files_wait_for_the_result(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("orbisim.recording")
    with notes_held_back() as notes:
        log.warning("a.csv: no time")
    assert notes == ["a.csv: no time"]
    with pytest.raises(InputError), notes_held_back():
        log.warning("a.csv: no time")
        log.warning("b.csv: no time")
        raise InputError("no recording")
    assert capsys.readouterr().err == "note: a.csv, b.csv: no time\n"
