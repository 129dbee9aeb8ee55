"""tools/suite_returns.py: paired episodes, what is kept of them, and their figures."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import suite_returns


def _row(seed: int, mujoco: float, learned: float, nudged: float = 1.0) -> dict[str, Any]:
    row = {"domain": "hopper", "seed": seed}
    return row | {"mujoco": mujoco, "nudged": nudged, "learned": learned}


def test_differences_are_paired() -> None:
    # returns differ by hundreds from episode to episode, learned ones by 1, 2 and 3 from MuJoCo's
    rows = [_row(0, 100.0, 101.0), _row(1, 500.0, 502.0), _row(2, 300.0, 297.0)]
    found = suite_returns.summary(rows)["hopper"]
    assert found["mujoco"]["standard_error"] == pytest.approx(200.0 / math.sqrt(3))
    assert found["apart"]["learned"] == pytest.approx(0.0)
    assert found["apart_error"]["learned"] == pytest.approx(math.sqrt(7 / 3) / 300.0)
    sizes = {"median": 2.0, "p90": pytest.approx(2.8), "worst": 3.0}
    assert found["differences"]["learned"] == sizes


def test_an_episode_that_diverges_counts_apart() -> None:
    rows = [_row(0, 4.0, 5.0), _row(1, 2.0, math.nan), _row(2, 6.0, 7.0)]
    found = suite_returns.summary(rows)["hopper"]
    assert found["learned"]["diverged"] == 1 and found["mujoco"]["diverged"] == 0
    assert found["apart"]["learned"] == pytest.approx(1.0 / 5.0)  # of the two others alone
    assert found["interval"]["learned"][0] > 0.0


def test_differences_are_no_share_of_nothing() -> None:
    found = suite_returns.summary([_row(0, 0.0, 1.0), _row(1, 0.0, 0.0)])["hopper"]
    assert math.isnan(found["apart"]["learned"])
    assert found["differences"]["learned"]["worst"] == 1.0


def test_an_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng, hit = np.random.default_rng(0), 0
    for _ in range(100):
        exact = rng.exponential(1.0, 60)
        pair = np.stack([exact, exact + rng.normal(0.1, 0.5, 60)])
        low, high = suite_returns._interval(pair)
        hit += low <= 0.1 <= high
    assert 88 <= hit <= 99


def test_what_is_finished_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def episode(job: tuple[str, str, int]) -> dict[str, Any]:
        made.append(job[2])
        return _row(job[2], 1.0, 2.0)

    monkeypatch.setattr(suite_returns, "episode", episode)
    rows = tmp_path / "rows.jsonl"
    rows.write_text(json.dumps(_row(10, 1.0, 2.0)) + "\n" + '{"domain": "hop')  # cut off
    found = suite_returns.table({"hopper": tmp_path}, {"hopper": 3}, 1, 10, rows)
    assert made == [11, 12] and found["hopper"]["episodes"] == 3
    suite_returns.table({"hopper": tmp_path}, 3, 1, 10, rows)
    assert made == [11, 12]


def test_domains_come_forward_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def episode(job: tuple[str, str, int]) -> dict[str, Any]:
        made.append(job[0])
        return _row(job[2], 1.0, 2.0) | {"domain": job[0]}

    monkeypatch.setattr(suite_returns, "episode", episode)
    suite_returns.table(
        dict.fromkeys(("hopper", "walker"), tmp_path), {"hopper": 8, "walker": 4}, 1
    )
    assert made[:6].count("hopper") == 4 and len(made) == 12


def test_a_domain_without_a_model_of_its_own_gets_the_one(tmp_path: Path) -> None:
    for name in ("suite_one", "cartpole"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "manifest.json").touch()
    found = suite_returns.chosen(tmp_path)
    assert found["cartpole"] == tmp_path / "cartpole"
    assert found["hopper"] == tmp_path / "suite_one" and len(found) == 9
    assert suite_returns.chosen(tmp_path, ["suite_one"])["cartpole"] == tmp_path / "suite_one"
    assert suite_returns.chosen(tmp_path, ["cartpole"]).keys() == {"cartpole"}
