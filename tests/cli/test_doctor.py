"""`orbisim doctor`: what works and what does not, each in one line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import pytest

from orbisim.cli import doctor
from orbisim.cli.doctor import Bench, Check
from orbisim.errors import MissingDependencyError


def _works(text: str) -> str:
    os.write(1, b"noise of an engine\n")
    return text


def _refuses() -> str:
    raise ValueError("two\nlines")


def _lacks() -> str:
    raise MissingDependencyError("reader 'x'", "urdf")


def _crashes() -> str:
    os.kill(os.getpid(), signal.SIGSEGV)
    return "never"


def _hangs() -> str:
    time.sleep(60)
    return "never"


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with Bench(30) as one:
        yield one


def test_each_end_is_one_line(bench: Bench, capfd: pytest.CaptureFixture[str]) -> None:
    found = bench.attempt("backend", "good", _works, "steps")
    assert (found.status, found.text.partition(" (")[0]) == ("ok", "steps")
    found = bench.attempt("backend", "bad", _refuses)
    assert (found.status, found.text) == ("failed", "ValueError: two lines")
    found = bench.attempt("reader", "x", _lacks)
    assert found.status == "absent" and "orbisim[urdf]" in found.text
    assert capfd.readouterr().out == ""


def test_a_crash_and_a_hang_end_only_themselves(bench: Bench) -> None:
    assert "crash" in bench.attempt("renderer", "broken", _crashes).text
    with Bench(1.0) as short:
        assert short.attempt("backend", "slow", _hangs).text == "no result within 1 s"
    assert bench.attempt("backend", "good", _works, "again").status == "ok"


def test_versions_are_those_installed() -> None:
    found = {check.name: check for check in doctor.versions() if check.kind == "version"}
    assert found["mujoco"].text == mujoco.__version__
    assert str(Path(doctor.__file__).parents[1]) in found["orbisim"].text


@pytest.mark.parametrize(
    ("work", "argument", "expected"),
    [
        (doctor._backend, "mujoco", "ok"),
        (doctor._renderer, "null", "ok"),
        (doctor._reader, ".mjcf", "ok"),
        (doctor._reader, ".urdf", "ok"),
        (doctor._reader, ".nothing", "failed"),
        (doctor._backend, "no such", "failed"),
    ],
)  # fmt: skip
def test_what_is_tried_is_used(work: object, argument: str, expected: str) -> None:
    assert doctor.tried(work, (argument,))[0] == expected  # type: ignore[arg-type]


def test_what_fails_is_the_exit_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    checks = [Check("backend", "mujoco", "ok", "steps"), Check("gpu", "cuda", "absent", "none")]
    monkeypatch.setattr(doctor, "examine", lambda limit: iter(checks))
    assert doctor.command.main(["--json"], standalone_mode=False) == 0
    assert json.loads(capsys.readouterr().out)["failed"] == 0
    checks.append(Check("renderer", "mujoco", "failed", "no EGL"))
    assert doctor.command.main([], standalone_mode=False) == 1
    assert capsys.readouterr().out.splitlines()[2].split() == [
        "renderer",
        "mujoco",
        "failed",
        "no",
        "EGL",
    ]


@pytest.mark.slow
def test_this_machine() -> None:
    program = Path(sys.executable).with_name("orbisim")
    done = subprocess.run([program, "doctor", "--json"], capture_output=True, text=True)
    found = {(c["kind"], c["name"]): c for c in json.loads(done.stdout)["checks"]}
    assert {("backend", "mujoco"), ("renderer", "null"), ("reader", ".xml")} <= set(found)
    assert found["backend", "mujoco"]["status"] == "ok"
    assert done.returncode == (1 if any(c["status"] == "failed" for c in found.values()) else 0)
