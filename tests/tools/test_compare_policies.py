"""`tools/suite_policies.py` at toy size: rows, what is not run again, and its table."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("stable_baselines3")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

import suite_policies
from suite_policies import Job, table, train


@pytest.fixture
def job(tmp_path: Path) -> Job:
    return Job("reacher-easy", "apg", 0, tmp_path, 64, None, 2, 4, 50, 2, "cpu", False)


@pytest.mark.parametrize(("method", "steps"), [("apg", 250_000), ("ppo", 64), ("sac", 64)])
def test_each_method_leaves_a_policy_and_its_return(
    method: str, steps: int, job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suite_policies, "WORLDS", {"ppo": 1, "sac": 8})
    job = dataclasses.replace(job, method=method)
    row = train(job)
    assert (row["task"], row["method"], row["seed"]) == job.key
    assert 0 <= row["mujoco"]["mean"] <= 50
    assert ("model" in row) == (method == "apg")
    if method != "ppo":  # which takes whole windows of 128
        assert row["true_steps"] == steps
    monkeypatch.setattr(suite_policies, "train_apg", None)  # what is done is not trained again
    again = train(job)
    assert again["mujoco"] == row["mujoco"] and again["training"] == row["training"]


def test_true_steps_are_those_of_the_dynamics() -> None:
    problem = suite_policies.SuiteProblem("pendulum-swingup", 50)
    assert suite_policies.true_steps(problem) == 250_000


def made(method: str, mean: float, seed: int) -> dict[str, Any]:
    row = {"task": "reacher-easy", "method": method, "seed": seed, "true_steps": 1000}
    return row | {"mujoco": {"mean": mean, "ci95_half": 2.0}}


def test_the_table_has_every_seed_and_the_mean() -> None:
    lines = table([made("ppo", 100.0, 0), made("ppo", 300.0, 1)]).splitlines()
    assert lines[2] == "| reacher-easy | ppo | 2 | 200 | 100 ± 2, 300 ± 2 |  | 1,000 |"
    assert len(lines) == 3
