"""MuJoCo's warnings are handed over, and the former handler comes back."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import mujoco
import pytest

from orbisim.host.engine_log import engine_warnings, ignore, silenced, without_warnings

FAST = """
<mujoco><option timestep=".1"/><worldbody>
  <body><joint type="slide" damping="-1e9"/><geom size=".1"/></body>
</worldbody></mujoco>
"""


def diverge() -> None:
    model = mujoco.MjModel.from_xml_string(FAST)
    data = mujoco.MjData(model)
    data.qvel[:] = 1e9
    mujoco.mj_step(model, data)
    mujoco.mj_step(model, data)


def test_warnings_are_handed_over_as_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    taken: list[str] = []
    with engine_warnings(taken.append):
        diverge()
    assert taken
    assert all(text == " ".join(text.split()) for text in taken)
    assert "unstable" in taken[0]
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())  # nor a log file


def test_the_former_handler_comes_back_also_after_an_error() -> None:
    outer: list[str] = []
    with engine_warnings(outer.append):
        with pytest.raises(KeyError), engine_warnings(ignore):
            diverge()
            raise KeyError
        assert not outer
        diverge()
    assert outer


def test_libraries_are_not_heard_meanwhile(capfd: pytest.CaptureFixture[str]) -> None:
    with silenced():
        os.write(2, b"noise")
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard"
    with contextlib.suppress(ZeroDivisionError), silenced():
        raise ZeroDivisionError
    os.write(2, b"again")
    assert capfd.readouterr().err == "again"


@pytest.mark.parametrize(("about", "heard"), [("unstable", 0), ("deprecated", 1)])
def test_one_warning_is_kept_back_and_others_reach_who_hears_them(about: str, heard: int) -> None:
    taken: list[str] = []
    with engine_warnings(taken.append), without_warnings(about):
        diverge()
    assert bool(taken) == bool(heard)
