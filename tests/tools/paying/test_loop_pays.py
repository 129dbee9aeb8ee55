"""`tools/loop_pays.py` at toy size: rows, what is not run again, table and figure."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("stable_baselines3")
sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

import loop_pays
from paying import conditions, search, training
from paying.table import figure, pooled, table
from paying.training import Plan, train


def plan(work: Path, scene: str, condition: str) -> Plan:
    return Plan(scene, condition, 0, work, steps=64, episodes=3, patience=20.0, fit=3.0)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "WORLDS", 4)
    monkeypatch.setattr(training, "WINDOW", 8)
    monkeypatch.setattr(search, "POPULATION", 8)
    for duty in conditions.DUTIES.values():
        monkeypatch.setattr(duty, "steps", 6)


@pytest.mark.parametrize("scene", conditions.DUTIES)
@pytest.mark.parametrize("condition", ["declared", "randomised", "true"])
def test_a_policy_is_trained_and_tried_on_the_machine(
    scene: str, condition: str, tmp_path: Path
) -> None:
    row = train(plan(tmp_path, scene, condition))
    assert (row["scene"], row["condition"], row["seed"]) == (scene, condition, 0)
    for place in ("machine", "own"):
        assert row[place]["episodes"] == 3 and not row[place]["diverged"]
    assert condition != "true" or row["machine"] == row["own"]
    again = train(plan(tmp_path, scene, condition))  # not trained, tried again
    assert again["machine"] == row["machine"]


def test_a_correction_is_learned_from_recordings_and_steps_the_training(tmp_path: Path) -> None:
    row = train(plan(tmp_path, "arm", "hybrid"))
    assert (tmp_path / "arm" / "0" / "hybrid" / "manifest.json").exists()
    assert row["machine"]["episodes"] == 3
    assert row["own"] != row["machine"]


def test_a_diagnosis_that_stands_in_the_folder_is_used(tmp_path: Path) -> None:
    """With what a diagnosis writes, made here: a search takes minutes."""
    kind, folder = conditions.DUTIES["arm"], tmp_path / "arm" / "0"
    conditions.machine(kind).save(folder / "diagnosis" / "augmented")
    report = {
        "schema": "orbisim.diagnosis/1",
        "verdict": "explained",
        "effects": [
            {"effect": e.effect, "target": e.target, "parameters": {"mass": {"value": 0.2}}}
            for e in kind.effects
        ],
        "augmented_scene": "augmented/scene.xml",
    }
    (folder / "diagnosis" / "report.json").write_text(json.dumps(report))
    (folder / "seconds.txt").write_text("30.5 12.5\n")
    row = train(plan(tmp_path, "arm", "diagnosed"))
    assert row["verdict"] == "explained" and row["diagnosis_processor_s"] == 12.5
    assert [one["effect"] for one in row["effects"]] == ["payload", "coulomb_friction"]
    assert row["own"] == row["machine"]


@pytest.mark.slow
def test_a_diagnosis_is_kept_and_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a patience that is too short to find much: the files are those of a long one."""
    kind = conditions.DUTIES["arm"]
    place, notes = conditions.diagnosed(kind, 0, tmp_path, 5.0)
    assert notes["verdict"] in ("explained", "partly_explained", "unexplained")
    assert notes["diagnosis_processor_s"] > 0
    monkeypatch.setattr(conditions.orbisim, "diagnose", None)
    again, read = conditions.diagnosed(kind, 0, tmp_path, 5.0)
    assert read == notes and again.scene.fingerprint == place.scene.fingerprint


def made(condition: str, wins: int, seed: int = 0) -> dict[str, Any]:
    tried = {"episodes": 10, "successes": wins, "share": wins / 10}
    tried |= {"reward": {"mean": 0.5}, "miss": {"median": 3.0}, "diverged": 0}
    return {"scene": "arm", "condition": condition, "seed": seed, "machine": tried, "own": tried}


def test_the_table_pools_seeds_and_says_how_many(tmp_path: Path) -> None:
    rows = [made("declared", 2), made("true", 10), made("declared", 4, 1)]
    share, (low, high) = pooled([rows[0], rows[2]], "machine")
    assert share == 0.3 and 0.1 < low < 0.2 < 0.45 < high < 0.6
    lines = table(rows).splitlines()
    assert len(lines) == 4
    assert lines[2].startswith("| arm | declared | 2 | 30, ") and "| 20, 40 |" in lines[2]
    figure(rows, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 1000


def test_a_line_that_was_cut_off_is_run_again(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    assert loop_pays.read_rows(path) == []
    path.write_text(json.dumps(made("true", 3)) + "\n" + '{"scene": "ar')
    assert [row["condition"] for row in loop_pays.read_rows(path)] == ["true"]
