"""The command line: what it prints, what it returns, what it says when the input is wrong."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import click
import pytest

from orbisim.agreement import EngineWarning
from orbisim.cli.main import COMMANDS, cli, in_one_line, run
from orbisim.testing import scenes


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "cartpole.xml"
    path.write_text(scenes.CARTPOLE)
    return str(path)


def output(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = run(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(capsys: pytest.CaptureFixture[str], command: str) -> None:
    status, out, _ = output(capsys, command, "--help")
    assert status == 0
    assert f"Example: orbisim {command}" in " ".join(out.split())
    assert "--json" in out


def all_commands(group: click.Group, context: click.Context) -> Iterator[click.Command]:
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from all_commands(command, context)
        yield command


def test_whatever_takes_a_scene_takes_the_options_of_urdf() -> None:
    group = cast(click.Group, cli)
    found = 0
    for command in all_commands(group, click.Context(group)):
        names = {parameter.name for parameter in command.params}
        shown = {parameter.metavar for parameter in command.params}
        if "scene" in names or "TASK-OR-SCENE" in shown:
            found += 1
            assert names >= {"actuators", "floating_base", "packages"}, command.name
    assert found >= 10


def test_help_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = output(capsys, "--help")
    assert status == 0
    assert all(command in out for command in COMMANDS)


_TIMELESS = "<mujoco><option timestep='0'/></mujoco>"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["inof", "x"], "did you mean 'info'"),
        (["info", "nothing.xml"], "nothing.xml: no such file"),
        (["info"], "Missing argument 'SCENE'"),
        (["sim", "SCENE", "--backend", "wrap"], "did you mean 'warp'"),
        (["sim", "SCENE", "--renderer", "mujco"], "did you mean 'mujoco'"),
        (["sim", "SCENE", "--duration", "-1"], "duration"),
        (["sim", "SCENE", "--duration", "x"], "'x' is not a valid float"),
        (["sim", "SCENE", "--size", "big", "--renderer", "null"], "height x width"),
        (["compare", "SCENE", "--episodes", "0"], "at least one episode"),
        (["compare", "suite:cheetah-fly"], "unknown task"),
        (["info", "SCENE", "--frobnicate"], "No such option"),
        (["sim", "SCENE", "--duration", "inf"], "duration"),
        (["sim", "SCENE", "--duration", "nan"], "duration"),
        (["sim", "SCENE", "--duration", "1e300"], "this machine has"),
        (["sim", "SCENE", "--worlds", "1000000000000"], "this machine has"),
        (["sim", "SCENE", "--fps", "0"], "--fps"),
        (["sim", "SCENE", "--fps", "nan"], "--fps"),
        (["sim", "SCENE", "--seed", "-1"], "--seed"),
        (["sim", "SCENE", "--out", "SCENE"], "is not a folder"),
        (["sim", _TIMELESS], "timestep is 0"),
        (["compare", "SCENE", "--seed", "-1"], "--seed"),
        (["compare", "SCENE", "--horizon", "inf"], "horizon"),
        (["compare", "SCENE", "--horizon", "1e300"], "this machine has"),
        (["compare", "SCENE", "--out", "SCENE/x"], "is not a folder"),
        (["compare", _TIMELESS], "timestep is 0"),
        (["replay", "SCENE", "a.npz", "--out", "SCENE"], "is not a folder"),
        (["diagnose", "SCENE", "a.npz", "--out", "SCENE"], "is not a folder"),
        (["diagnose", "SCENE", "a.npz", "--seed", "-1"], "--seed"),
        (["collect", "ball", "--seed", "-1", "--out", "x.h5"], "--seed"),
    ],
)
def test_wrong_input(
    capsys: pytest.CaptureFixture[str], scene: str, arguments: list[str], message: str
) -> None:
    status, out, err = output(capsys, *[a.replace("SCENE", scene) for a in arguments])
    assert status == 2
    assert out == ""
    assert message in err
    assert err.startswith("error: ")
    assert err.count("\n") == 1


def test_a_fault_of_ours_is_no_traceback(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, scene: str
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr("orbisim.compare.compare", broken)
    status, _, err = output(capsys, "compare", scene)
    assert status == 1
    assert "a fault in OrbiSim: RuntimeError: two lines" in err
    assert "Traceback" not in err


def test_the_program_is_installed(scene: str) -> None:
    program = Path(sys.executable).with_name("orbisim")
    done = subprocess.run(
        [program, "info", scene, "--json"], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout)["name"] == "cartpole"
    bad = subprocess.run([program, "info", "x.abc"], capture_output=True, text=True)
    assert bad.returncode == 2


def test_importing_orbisim_loads_nothing_heavy() -> None:
    code = (
        "import sys, orbisim; "
        "heavy = {'torch', 'warp', 'mujoco', 'dm_control', 'matplotlib', 'trimesh'}; "
        "heavy &= set(sys.modules); "
        "assert not heavy, heavy; "
        "orbisim.load_scene('<mujoco/>'); "
        "assert not {'torch', 'warp', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_own_warnings_are_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with in_one_line():
        for world in range(5):
            warnings.warn(f"world {world}\nis lost", EngineWarning, stacklevel=1)
    said = capsys.readouterr().err.splitlines()
    assert said == [
        *(f"warning: world {world} is lost" for world in range(3)),
        "warning: 2 more of the kind (EngineWarning)",
    ]
    with pytest.warns(UserWarning, match="of another"), in_one_line():
        warnings.warn("of another", UserWarning, stacklevel=1)
    assert capsys.readouterr().err == ""


def test_what_is_logged_is_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with in_one_line():
        logging.getLogger("orbisim.recording").warning("%s: a column\nis missing", "run.csv")
        logging.getLogger("orbisim.files").info("replaced")
    assert capsys.readouterr().err == "note: run.csv: a column is missing\n"
    assert logging.getLogger("orbisim").propagate
