"""`tools/compare_policies.py` at toy size: rows, what is not run again, its choice and tables."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("stable_baselines3")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

import compare_policies
from compare_policies import Job, best, key_of, settings, work
from orbisim_policies.problems import make_problem
from policy_table import figure, table


@pytest.fixture
def job(tmp_path: Path) -> Job:
    fields: dict[str, Any] = {"kind": "policy", "task": "task:push", "method": "ppo"}
    fields |= {"seed": 0, "choice": 0, "work": tmp_path, "steps": 64, "limit": 1.0}
    fields |= {"worlds": 2, "length": 4, "episodes": 2, "device": "cpu", "threads": 1}
    fields |= {"compiled": False, "check_every": 60.0, "demonstrations": 3, "cloning": 3}
    return Job(**fields)


@pytest.mark.slow
@pytest.mark.parametrize("method", compare_policies.METHODS)
def test_each_method_leaves_a_policy_and_what_it_is_worth(
    method: str, job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare_policies, "CHECK", 2)
    counted = ("ppo", "ppo_rnd", "sac", "dreamer", "apg_mujoco")  # these have steps
    limit = None if method in counted else 1.0
    job = dataclasses.replace(job, method=method, limit=limit)
    rewards = ("r1", "r2", "r3")
    if method == "apg_mujoco":  # not of push, whose episodes have scenes of their own
        task, length = "suite:pendulum-swingup", compare_policies.HORIZON
        job, rewards = dataclasses.replace(job, task=task, length=length), ("return",)
    row = work(job)
    assert key_of(row) == job.key
    for place in ("mujoco", "model"):
        if job.task == "task:push":
            assert set(row[place]["success"]) == {"moved", "on_table", "region"}
        assert set(row[place]["reward"]) == set(rewards)
        assert row[place]["episodes"] == 2
    for name in rewards:
        assert len(row["curve"][f"true_{name}"]) == len(row["curve"]["true_steps"]) > 0
    assert row["check"]["episodes"] == 2 and row["true_steps"] > 0
    monkeypatch.setattr(compare_policies, "train_apg", None)  # what is done is not trained again
    again = work(job)
    assert again["mujoco"] == row["mujoco"] and again["training"] == row["training"]


def made(method: str, seed: int, moved: int, kind: str = "policy", choice: int = 0) -> Any:
    shares = {"moved": moved, "on_table": moved, "region": 0}
    success = {n: {"share": v / 100, "successes": v, "ci95": [0, 1]} for n, v in shares.items()}
    reward = {n: {"mean": moved / 100, "ci95_half": 0.1} for n in ("r1", "r2", "r3")}
    side = {"episodes": 100, "success": success, "reward": reward}
    curve = {"true_steps": [640.0, 6400.0], "seconds": [1.0, 2.0]}
    curve |= {f"true_{name}": [0.1, 0.2] for name in reward} | {"success_moved": [0.0, 0.5]}
    row = {"kind": kind, "task": "task:push", "method": method, "seed": seed, "choice": choice}
    row |= {"settings": {"rate": 1e-3}, "steps_of_episode": 64, "true_steps": 6400, "mujoco": side}
    return row | {"model": side, "curve": curve, "trained_s": 10.0}


def test_the_table_pools_seeds_and_shows_each(tmp_path: Path) -> None:
    rows = [made("ppo", 1, 90), made("ppo", 0, 70), made("sac", 0, 0)]
    lines = table(rows).splitlines()
    assert lines[2].startswith("| ppo | 2 | 80.0, 73.9 to 85.0 | 80.0, 73.9 to 85.0 | 0.0, 0.0 to")
    assert "| 70, 90 | 80.0, 80.0, 0.0 | 0.80, 0.80, 0.80 |" in lines[2]
    assert lines[2].endswith("| 6,400 | 100 | 10 |") and len(lines) == 4
    figure(rows, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000


def test_a_policy_has_the_configuration_that_did_best_in_the_search() -> None:
    rows = [made("ppo", 100, 10 * i, "search", i) for i in (1, 3, 2)]
    assert best(rows, "task:push", "ppo") == 3
    assert best(rows, "task:push", "sac") == 0
    assert table(rows).count("rate 0.001") == 3  # and no table of policies
    assert len({key_of(row) for row in rows}) == 3
    assert key_of(made("ppo", 0, 1, choice=2)) == key_of(made("ppo", 0, 1, choice=1))


def test_tasks_of_the_suite_have_short_horizons_and_larger_rates(job: Job) -> None:
    job = dataclasses.replace(job, method="apg")
    push = settings(job, make_problem("task:push", 4))
    suite = settings(job, make_problem("suite:pendulum-swingup", 50))
    assert push["horizon"] == 0 and suite["horizon"] == compare_policies.HORIZON
    assert suite["rate"] == 2.5 * push["rate"] == 5e-4


def test_short_horizons_with_a_value_are_a_method_of_their_own(job: Job) -> None:
    job = dataclasses.replace(job, method="shac")
    assert settings(job, make_problem("task:push"))["horizon"] == compare_policies.SPARSE_HORIZON
    longer = dataclasses.replace(job, choice=2)
    assert settings(longer, make_problem("task:push"))["horizon"] == 32
    assert job.lane == "device"


def test_every_method_is_searched_as_much() -> None:
    assert {len(space) for space in compare_policies.SPACE.values()} == {4}
    assert set(compare_policies.SPACE) == set(compare_policies.METHODS)


def test_configurations_have_the_same_true_steps_and_seconds_unless_told_otherwise() -> None:
    names = ("steps", "demonstrations", "limit")
    searched = argparse.Namespace(search=True, **dict.fromkeys(names))
    compare_policies.budget(searched)
    assert searched.demonstrations * make_problem("task:push").steps == searched.steps == 40_000
    assert searched.limit == 280.0
    reported = argparse.Namespace(search=False, steps=7, demonstrations=None, limit=None)
    compare_policies.budget(reported)
    assert (reported.steps, reported.demonstrations, reported.limit) == (7, 1000, 400.0)
