"""A fleet: every robot on its own, and one table."""

from __future__ import annotations

import json
import types
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import orbisim
from orbisim import Fleet, diagnose_fleet
from orbisim.cli.main import run
from orbisim.diagnosis import Settings
from orbisim.effects import EffectInstance
from orbisim.fleet import run as fleet
from orbisim.fleet.run import Options
from orbisim.testing import inject_effect

SCENE = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


@pytest.fixture
def robots(arm: orbisim.Scene, tmp_path: Path) -> Path:
    """Five robots; one has a file that is no recording, one has no files."""
    one = inject_effect(arm, [], duration=0.3, episodes=1)[0]
    for name in ("a", "b", "c", "bad", "empty"):
        (tmp_path / "in" / name).mkdir(parents=True)
        if name != "empty":
            one.save(tmp_path / "in" / name / "run.npz")
    (tmp_path / "in" / "bad" / "run.npz").write_bytes(b"no archive")
    return tmp_path / "in"


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The robots that were diagnosed: by a stand-in that writes a report, in this process."""
    seen: list[str] = []

    def diagnose(scene: Any, recordings: Sequence[Any], *, out: Path, **options: Any) -> None:
        seen.append(out.name)
        report = {
            "effects": [], "verdict": "no_residual", "sentence": f"{len(recordings)} recording",
            "error": {"held_out": {"before": 1e-3, "after": 1e-3}, "noise_floor": 1e-3},
        }  # fmt: skip
        (out / "report.json").write_text(json.dumps(report))

    def inline(work: Callable[..., None], jobs: Any, workers: int) -> Iterator[None]:
        for job in jobs:
            yield work(*job)

    monkeypatch.setattr(fleet, "diagnose", diagnose)
    monkeypatch.setattr(fleet, "pool", types.SimpleNamespace(run=inline))
    return seen


def test_a_bad_robot_does_not_stop_the_others(
    robots: Path, tmp_path: Path, done: list[str]
) -> None:
    found = diagnose_fleet(SCENE, robots, tmp_path / "out")
    assert isinstance(found, Fleet)
    assert done == ["a", "b", "c"]
    problems = {one.name: one.problem for one in found.robots}
    assert problems["empty"] == "no recordings" and "run.npz" in problems["bad"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["schema"] == "orbisim.fleet/1" and len(report["robots"]) == 5
    page = (tmp_path / "out" / "report.html").read_text()
    assert "no recordings" in page and "robots/a/report.html" in page
    assert "bad" in (tmp_path / "out" / "fleet.csv").read_text()


def test_what_is_done_is_not_done_again(robots: Path, tmp_path: Path, done: list[str]) -> None:
    diagnose_fleet(SCENE, robots, tmp_path / "out")
    done.clear()
    (robots / "a" / "run.npz").rename(robots / "b" / "more.npz")  # a has none now, b two
    found = diagnose_fleet(SCENE, robots, tmp_path / "out")
    assert done == ["b"]
    assert {one.name: one.problem for one in found.robots}["a"] == "no recordings"
    done.clear()
    diagnose_fleet(SCENE, robots, tmp_path / "out", Options(settings=Settings(seed=1)))
    assert done == ["b", "c"]  # another seed is another result


@pytest.mark.parametrize("name", ["report.json", "inputs.json"])
@pytest.mark.parametrize("content", [b"", b"[]", b'{"effects": 3}', b"\xff", b"[" * 100_000])
def test_a_damaged_result_is_made_anew(
    robots: Path, tmp_path: Path, done: list[str], name: str, content: bytes
) -> None:
    diagnose_fleet(SCENE, robots, tmp_path / "out")
    done.clear()
    (tmp_path / "out" / "robots" / "b" / name).write_bytes(content)
    found = diagnose_fleet(SCENE, robots, tmp_path / "out")
    assert done == ["b"]
    assert not {one.name: one.problem for one in found.robots}["b"]


def test_a_fault_of_ours_is_one_robots(
    robots: Path, tmp_path: Path, done: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in = fleet.diagnose

    def faulty(scene: Any, recordings: Any, *, out: Path, **options: Any) -> None:
        if out.name == "b":
            raise ZeroDivisionError("somewhere")
        stand_in(scene, recordings, out=out, **options)

    monkeypatch.setattr(fleet, "diagnose", faulty)
    found = diagnose_fleet(SCENE, robots, tmp_path / "out")
    problems = {one.name: one.problem for one in found.robots}
    assert "a fault in OrbiSim: ZeroDivisionError" in problems["b"] and not problems["c"]


def test_the_command_prints_the_table(
    robots: Path, tmp_path: Path, done: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["diagnose", str(SCENE), "--fleet", str(robots), "--out", str(tmp_path / "out")]
    assert run(words) == 0
    printed = capsys.readouterr().out
    assert "no_residual" in printed and "no diagnosis: no recordings" in " ".join(printed.split())
    assert run([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["outliers"] == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--out", "OUT"], "name recordings"),
        (["--fleet", "IN"], "--fleet needs --out"),
        (["run.npz", "--fleet", "IN", "--out", "OUT"], "goes without RECORDING"),
        (["run.npz", "--workers", "2"], "go with --fleet"),
        (["--fleet", "IN/a", "--out", "OUT"], "has no folders"),
        (["--fleet", "nothing", "--out", "OUT"], "is not a folder"),
        (["--fleet", "IN", "--out", "OUT", "--workers", "0"], "at least one worker"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    words: list[str],
    message: str,
    robots: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    places = {"IN": str(robots), "OUT": str(tmp_path / "out"), "IN/a": str(robots / "a")}
    assert run(["diagnose", str(SCENE), *(places.get(w, w) for w in words)]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_the_arm_with_the_worn_gear_is_found(arm: orbisim.Scene, tmp_path: Path) -> None:
    for number in range(4):
        worn = EffectInstance("coulomb_friction", "elbow", {"torque": 0.12})
        some = inject_effect(
            arm, [worn] if number == 2 else [], duration=4.0, episodes=4, seed=number
        )
        folder = tmp_path / "in" / f"arm{number}"
        folder.mkdir(parents=True)
        for i, one in enumerate(some):
            one.save(folder / f"run{i}.npz")
    found = diagnose_fleet(SCENE, tmp_path / "in", tmp_path / "out", workers=2)
    assert found.outliers == ("arm2",)
    assert (found.rows[0].effect, found.rows[0].target) == ("coulomb_friction", "elbow")
    assert (tmp_path / "out" / "robots" / "arm2" / "augmented" / "scene.xml").is_file()
