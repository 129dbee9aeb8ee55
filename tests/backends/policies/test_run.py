from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from orbisim_policies import run as running
from orbisim_policies.apg import Apg, ApgConfig
from orbisim_policies.checkpoint import load_policy
from orbisim_policies.network import NetworkConfig
from orbisim_policies.run import Run, train_apg
from orbisim_policies.suite import SuiteProblem

from orbisim.errors import InputError, OrbiSimError

SMALL = ApgConfig(batch=2, horizon=4, network=NetworkConfig((4,)))


def job(out: Path, **changes: object) -> Run:
    fixed = Run(out, steps=6, starts=3, check=0, save_every=0.0, log_every=1, nthread=1)
    return dataclasses.replace(fixed, **changes)  # type: ignore[arg-type]


def test_a_killed_training_goes_on_exactly(
    cartpole: SuiteProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_apg(cartpole, SMALL, job(tmp_path / "whole"))
    step = Apg.step

    def killed(self: Apg, progress: float) -> object:
        if self.done == 3:
            raise KeyboardInterrupt
        return step(self, progress)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Apg, "step", killed)
        train_apg(cartpole, SMALL, job(tmp_path / "parts"))
    with pytest.raises(InputError, match="holds a training"):
        train_apg(cartpole, SMALL, job(tmp_path / "parts"))
    train_apg(cartpole, SMALL, job(tmp_path / "parts", resume=True))
    names = ("policy.safetensors",)
    for name in names:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "parts" / name).read_bytes()
    lines = [
        [json.loads(row) for row in (tmp_path / part / "metrics.jsonl").read_text().splitlines()]
        for part in ("whole", "parts")
    ]
    keep = [[(row["step"], row["objective"]) for row in part] for part in lines]
    assert keep[0] == keep[1]


def test_a_training_leaves_policy_curves_and_live_estimates(
    cartpole: SuiteProblem, tmp_path: Path
) -> None:
    lines: list[dict[str, object]] = []
    job_of = job(tmp_path / "p", steps=2, check=2)
    manifest = train_apg(cartpole, SMALL, job_of, report=lines.append)
    assert manifest["dynamics"] == "cartpole" and manifest["true_steps"] > 0
    assert {"curves.png", "metrics.jsonl"} <= {p.name for p in (tmp_path / "p").iterdir()}
    assert "success_return" in lines[-1] and load_policy(tmp_path / "p", cartpole)
    began = train_apg(cartpole, SMALL, job(tmp_path / "q", steps=1, start=tmp_path / "p"))
    assert began["start"] == "p"


def test_what_cannot_be_trained_is_refused(cartpole: SuiteProblem, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="budget"):
        train_apg(cartpole, SMALL, Run(tmp_path / "p"))
    train_apg(cartpole, SMALL, job(tmp_path / "p", steps=1))
    for change, text in (({"seed": 1}, "--seed 0"), ({}, "other settings")):
        config = SMALL if change else dataclasses.replace(SMALL, noise=0.3)
        with pytest.raises(InputError, match=text):
            train_apg(cartpole, config, job(tmp_path / "p", resume=True, **change))


def test_a_training_without_a_finite_number_ends_with_an_error(
    cartpole: SuiteProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch

    monkeypatch.setattr(Apg, "step", lambda self, progress: torch.full((4,), float("nan")))
    with pytest.raises(OrbiSimError, match="diverged"):
        train_apg(cartpole, SMALL, job(tmp_path / "p"))
    assert running.METRICS in {p.name for p in (tmp_path / "p").iterdir()}


def test_the_policy_with_the_best_estimate_is_kept(
    cartpole: SuiteProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = running.summary
    values = iter([0.3, 0.5, 0.2, 0.1])  # at last of the one that the training chooses, too

    def rated(*arguments: object) -> object:
        known = found(*arguments)  # type: ignore[arg-type]
        known["reward"]["return"]["mean"] = next(values)
        return known

    monkeypatch.setattr(running, "summary", rated)
    lines: list[dict[str, object]] = []
    job_of = job(tmp_path / "p", steps=2, check=2, check_every=0.0)
    manifest = train_apg(cartpole, SMALL, job_of, report=lines.append)
    assert [line["true_return"] for line in lines if "true_return" in line] == [0.3, 0.5, 0.1]
    check = {"episodes": 2, "true_steps": 64, "reward": 0.5, "step": 2}
    assert manifest["check"] == check
    kept = load_policy(tmp_path / "p", cartpole)
    other = train_apg(cartpole, SMALL, job(tmp_path / "q", steps=2, limit=None))
    last = load_policy(tmp_path / "q", cartpole)
    assert other["check"]["true_steps"] == 0 and kept.config == last.config
