"""What the commands share."""

from __future__ import annotations

import json
import logging

import pytest

from orbisim.cli.common import emit_json, note, print_table, quiet_engine


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
