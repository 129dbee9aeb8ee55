"""A fixed few of the blind trials, and the machinery that makes and scores them.

The whole grid takes hours of work: `python tools/blind_trials.py`.
"""

from __future__ import annotations

import importlib
import json
import sys
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from orbisim import Recording
from orbisim.recording import bind

TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture(scope="module", autouse=True)
def _tools_on_path() -> Iterator[None]:
    sys.path.insert(0, str(TOOLS))
    yield
    sys.path.remove(str(TOOLS))


def tool(name: str) -> Any:
    return importlib.import_module(name)


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("blind")
    assert (
        tool("blind_trials").main(["generate", "--out", str(out), "--sample", "--workers", "2"])
        == 0
    )
    return out


# -- making ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_the_diagnosis_opens_says_nothing_about_the_effect(trials: Path) -> None:
    rigs = tool("blind.scenes").RIGS
    for folder in sorted((trials / "trials").iterdir()):
        for path in folder.iterdir():
            assert path.name == "scene.xml" or path.name.startswith(("fit_", "held_"))
        wish = json.loads((trials / "truth" / f"{folder.name}.json").read_text())["wish"]
        rig, text = rigs[wish["scene"]], (folder / "scene.xml").read_text()
        if wish["wrong"] == "right":
            assert text == rig.path.read_text()
        else:  # the same elements with other numbers
            one, other = (ElementTree.fromstring(t) for t in (text, rig.path.read_text()))
            assert [e.tag for e in one.iter()] == [e.tag for e in other.iter()]
        recording = Recording.load(folder / "fit_0.npz")
        assert not recording.metadata
        bind(recording, rig.scene())  # no joint that only the true scene has


@pytest.mark.slow
def test_every_injected_effect_shows(trials: Path) -> None:
    for path in sorted((trials / "truth").glob("s*.json")):
        truth = json.loads(path.read_text())
        assert all(shift >= 10 for shift in truth["shift_over_noise"]), path.name


def test_trials_are_made_alike_from_the_same_seed(tmp_path: Path) -> None:
    grid, making = tool("blind.grid"), tool("blind.making")
    wish = grid._one("coulomb_friction", "servo_pendulum", "servo", seed=5)
    for name in ("a", "b"):
        making.make(wish, "t0", tmp_path / name)
    one, two = (np.load(tmp_path / n / "trials" / "t0" / "held_0.npz") for n in ("a", "b"))
    assert all(np.array_equal(one[k], two[k]) for k in one.files if one[k].dtype.kind == "f")


def test_declared_parameters_are_off_by_a_few_percent() -> None:
    rig = tool("blind.scenes").RIGS["arm6"]
    alter = tool("blind.declared").alter
    true = rig.scene().model
    for what, field in (("mass", "body_mass"), ("damping", "dof_damping")):
        text, factors = alter(rig.path.read_text(), what, np.random.default_rng(0))
        model = mujoco.MjModel.from_xml_string(text)
        was, now = np.ravel(getattr(true, field)), np.ravel(getattr(model, field))
        moved = now[was > 0] / was[was > 0]
        assert factors
        assert np.all((np.abs(moved - 1) <= 0.0501) & (np.abs(moved - 1) >= 0.0199))


def test_no_effect_outside_the_catalogue_is_registered() -> None:
    kinds = tool("blind.outside").KINDS
    assert len(kinds) >= 6
    assert not set(kinds) & set(tool("orbisim.effects").effect_names())


# -- scoring ---------------------------------------------------------------------------------------


def effect(name: str, target: str, **parameters: float) -> dict[str, Any]:
    return {"effect": name, "target": target, "parameters": parameters}


def test_factors_are_judged_by_how_far_they_are_from_one() -> None:
    matching = tool("blind.matching")
    found, truth = (
        effect("clock_skew", "recording", factor=1.03),
        effect("clock_skew", "recording", factor=1.02),
    )
    assert matching.relative_error(found, truth) == pytest.approx(0.5)


def line(trial: str, tool: str, after: float, **more: Any) -> str:
    report = {"verdict": "explained", "effects": [], "error": {"held_out": {"after": after}}} | more
    return json.dumps(
        {"trial": trial, "tool": tool, "seconds": 1.0, "failure": None, "report": report}
    )


@pytest.mark.slow
def test_errors_are_set_beside_the_true_scene_and_the_peer(trials: Path, tmp_path: Path) -> None:
    truth = json.loads((trials / "truth" / "s01.json").read_text())
    true, declared = (truth["held_out_error"][key] for key in ("true", "declared"))
    assert 0 < true < 0.3 * declared
    results = tmp_path / "results.jsonl"
    cut_off = line("s01", "peer", 0.5 * declared)[:40]
    lines = [
        line("s01", "diagnose", 2.5 * true, effects=truth["effects"]),
        line("s01", "peer", 1.2 * declared, values={"elbow_damping": 0.1}),
        json.dumps({"trial": "s00", "tool": "diagnose", "seconds": 9.0, "report": None,
                    "failure": "took more than 9 s"}),
        cut_off,
    ]  # fmt: skip
    results.write_text("\n".join(lines))
    stopped, found = tool("blind.outcomes").outcomes_of(trials, results)
    assert found.right
    assert found.over_true == pytest.approx(2.5)
    assert found.peer == pytest.approx(1.2 * declared)
    assert not stopped.right
    assert stopped.after == stopped.declared  # nothing was named
    text = tool("blind.summary").summary([stopped, found])
    assert "| one effect | 1 | " in text
    row = next(row for row in text.splitlines() if row.startswith("| one effect | 1 |"))
    assert "| 120 % | 1 |" in row


@pytest.mark.slow
def test_what_crashes_or_takes_too_long_is_recorded(trials: Path, tmp_path: Path) -> None:
    broken = tmp_path / "trials" / "trials" / "t0"
    broken.mkdir(parents=True)
    (broken / "scene.xml").write_text((trials / "trials" / "s00" / "scene.xml").read_text())
    (broken / "fit_0.npz").write_bytes(b"no recording")
    asked = settings(tmp_path / "trials", tmp_path / "results.jsonl", tools=["diagnose"])
    running = tool("blind.running")
    assert running.run_all(asked) == 0
    (entry,) = tool("processes").read_lines(tmp_path / "results.jsonl")
    assert "RecordingError" in entry["failure"]
    asked = settings(trials, tmp_path / "late.jsonl", only=["s00"], tools=["diagnose"], timeout=0.1)
    assert running.run_all(asked) == 0
    (entry,) = tool("processes").read_lines(tmp_path / "late.jsonl")
    assert entry["failure"] == "took more than 0.1 s"
    assert [job.trial for job in running.jobs_of(asked)] == []
    asked.again = True
    assert [job.trial for job in running.jobs_of(asked)] == ["s00"]


def test_trials_and_scenes_that_are_not_there_are_errors(tmp_path: Path) -> None:
    one = tmp_path / "trials" / "t0"
    one.mkdir(parents=True)
    (one / "scene.xml").write_text('<mujoco model="puck"/>')
    jobs_of = tool("blind.running").jobs_of
    for name in ("t0", "puck"):
        asked = settings(tmp_path, tmp_path / "out.jsonl", only=[name], tools=["diagnose"])
        assert [job.trial for job in jobs_of(asked)] == ["t0"]
    with pytest.raises(SystemExit, match="no trial or scene 't1' among the 1"):
        jobs_of(settings(tmp_path, tmp_path / "out.jsonl", only=["puck", "t1"]))
    with pytest.raises(SystemExit):  # nothing after --only is not everything
        tool("blind_trials").main(["run", "--trials", "x", "--out", "y", "--only"])


# -- the sample ------------------------------------------------------------------------------------


def test_trials_of_some_scenes_may_come_first(tmp_path: Path) -> None:
    for name, scene in (("t0", "arm2"), ("t1", "leg"), ("t2", "arm2"), ("t3", "puck")):
        one = tmp_path / "trials" / name
        one.mkdir(parents=True)
        (one / "scene.xml").write_text(f'<mujoco model="{scene}"/>')
    asked = settings(tmp_path, tmp_path / "out.jsonl", first=["leg", "puck"], tools=["diagnose"])
    jobs = tool("blind.running").jobs_of(asked)
    assert [job.trial for job in jobs] == ["t1", "t3", "t0", "t2"]


def settings(trials: Path, out: Path, **more: Any) -> Namespace:
    every = {"sample": False, "only": [], "first": [], "limit": 0, "again": False, "workers": 2,
             "timeout": 300.0, "peer_timeout": 20.0, "time_limit": 0.0, "patience": None,
             "tools": ["diagnose", "peer"]}  # fmt: skip
    return Namespace(trials=str(trials), out=str(out), **(every | more))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_sample_is_diagnosed(trials: Path, tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    running, scoring = tool("blind.running"), tool("blind.scoring")
    asked = settings(trials, results, sample=True, tools=["diagnose"])
    assert running.run_all(asked) == 0
    outcomes = tool("blind.outcomes").outcomes_of(trials, results)
    told = scoring.failures(outcomes)
    assert len(outcomes) == len(tool("blind.grid").SAMPLE)
    assert not [o.failure for o in outcomes if o.failure], told
    assert not [o for o in outcomes if o.kind in ("none", "outside") and not o.right], told
    singles = [o for o in outcomes if o.kind == "single"]
    assert sum(o.right for o in singles) >= len(singles) - 1, told
    assert np.nanmedian([o.relative_error for o in singles if o.right]) < 0.05, told
    assert np.median([o.over_true for o in singles]) < 3, told
    # everything that was asked for has been done: a second run has nothing to do
    assert running.jobs_of(asked) == []


@pytest.mark.slow
def test_the_peer_fits_what_it_knows(trials: Path, tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    asked = settings(trials, results, only=["s05"], tools=["peer"], peer_timeout=5.0)
    tool("blind.running").run_all(asked)
    (entry,) = tool("processes").read_lines(results)
    assert entry["failure"] is None
    assert entry["report"]["verdict"] in ("fitted", "stopped")
    assert set(entry["report"]["values"]) == {
        f"servo_{kind}" for kind in ("armature", "frictionloss", "damping", "stiffness")
    }
    truth = json.loads((trials / "truth" / "s05.json").read_text())
    error = entry["report"]["error"]["held_out"]
    assert error["before"] == pytest.approx(truth["held_out_error"]["declared"])
    assert error["after"] < error["before"]
