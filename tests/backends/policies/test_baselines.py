from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("stable_baselines3")

from orbisim_policies import baselines
from orbisim_policies.baselines import Baseline, Curiosity, ProblemVecEnv, train_baseline
from orbisim_policies.checkpoint import load_policy
from orbisim_policies.dreamer import DreamerConfig, train_dreamer
from orbisim_policies.network import NetworkConfig
from orbisim_policies.run import Run
from orbisim_policies.successive import SuccessiveEpisodes
from orbisim_policies.suite import SuiteProblem

from orbisim.errors import InputError


def test_episodes_follow_each_other_and_rewards_add_up(cartpole: SuiteProblem) -> None:
    environment = ProblemVecEnv(SuccessiveEpisodes(cartpole, 2, cartpole.draw([1, 2]), nthread=1))
    environment.reset()
    total = np.zeros(2)
    for step in range(cartpole.steps):
        _, reward, done, infos = environment.step(np.zeros((2, 1)))
        total += reward
        assert done.all() == (step == cartpole.steps - 1)
    for world in range(2):
        mean = infos[world]["parts"]["return"]
        assert total[world] / cartpole.steps == pytest.approx(mean, rel=1e-4)
        assert infos[world]["TimeLimit.truncated"]
    environment.close()


def test_a_reward_that_is_no_number_begins_that_world_anew(
    cartpole: SuiteProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = ProblemVecEnv(SuccessiveEpisodes(cartpole, 2, cartpole.draw([1, 2]), nthread=1))
    environment.reset()
    worth = environment.worlds.worth

    def broken() -> torch.Tensor:
        value = worth()
        value[1] = float("nan")
        return value

    monkeypatch.setattr(environment.worlds, "worth", broken)
    view, reward, done, infos = environment.step(np.zeros((2, 1)))
    assert done.tolist() == [False, True] and reward[1] == 0.0 and infos[1]["diverged"]
    assert environment.diverged.tolist() == [0, 1] and np.isfinite(view).all()
    environment.close()


@pytest.mark.parametrize("method", ["sac", "ppo", "ppo_rnd"])
def test_a_baseline_leaves_a_policy_that_acts_as_the_library_does(
    cartpole: SuiteProblem, tmp_path: Path, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Baseline(method, batch=2, window=32, network=NetworkConfig((8,)))
    job = Run(tmp_path / "p", steps=128, starts=3, check=2, nthread=1)
    kept = {}
    learner = baselines._learner

    def watched(*arguments: object) -> object:
        kept["model"], policy_of = learner(*arguments)  # type: ignore[arg-type]
        return kept["model"], policy_of

    monkeypatch.setattr(baselines, "_learner", watched)
    manifest = train_baseline(cartpole, config, job)
    assert manifest["true_steps"] >= 128
    policy = load_policy(tmp_path / "p", cartpole)
    view = np.random.default_rng(0).normal(size=(5, cartpole.observations)).astype(np.float32)
    expected, _ = kept["model"].predict(view, deterministic=True)
    np.testing.assert_allclose(policy(torch.tensor(view)).detach(), expected, atol=1e-5)
    with pytest.raises(InputError, match="other settings"):
        other = dataclasses.replace(config, rate=1e-2)
        train_baseline(cartpole, other, dataclasses.replace(job, resume=True))
    with pytest.raises(InputError, match="--seed 0, not 1"):
        train_baseline(cartpole, config, dataclasses.replace(job, resume=True, seed=1))


@pytest.mark.parametrize("method", ["sac", "ppo_rnd"])
def test_a_killed_training_goes_on_exactly(
    cartpole: SuiteProblem, tmp_path: Path, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of episodes, with live estimates at other times; its curves, too."""
    monkeypatch.setattr(baselines, "LINE", 20)
    config = Baseline(method, batch=2, window=33, network=NetworkConfig((8,)))
    job = Run(tmp_path / "whole", steps=198, starts=3, check=0, nthread=1, save_every=0.0)
    train_baseline(cartpole, config, job)
    step, parts = ProblemVecEnv.step_wait, dataclasses.replace(job, out=tmp_path / "parts")

    def killed(self: ProblemVecEnv) -> object:
        if self.worlds.steps == 150:
            raise KeyboardInterrupt
        return step(self)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(ProblemVecEnv, "step_wait", killed)
        train_baseline(cartpole, config, dataclasses.replace(parts, check=2, check_every=0.0))
    torch.manual_seed(5)
    again = dataclasses.replace(parts, resume=True)
    manifest = train_baseline(cartpole, config, again)
    weights = [(out / "policy.safetensors").read_bytes() for out in (job.out, parts.out)]
    assert weights[0] == weights[1]
    assert manifest["true_steps"] == 198 == manifest["training"]["step"]
    curves = [curve(out) for out in (job.out, parts.out)]
    assert curves[0] == curves[1] and len(curves[0]) > 8


@pytest.mark.parametrize("method", ["sac", "dreamer"])
def test_a_training_that_ends_with_an_error_closes_its_worlds(
    cartpole: SuiteProblem, tmp_path: Path, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = []
    close = SuccessiveEpisodes.close
    monkeypatch.setattr(SuccessiveEpisodes, "close", lambda self: (closed.append(1), close(self)))

    def broken(self: object, action: object) -> None:
        raise RuntimeError("no step")

    monkeypatch.setattr(SuccessiveEpisodes, "step", broken)
    run = Run(tmp_path / "p", steps=64, starts=4, check=0, nthread=1)
    with pytest.raises(RuntimeError, match="no step"):
        if method == "sac":
            train_baseline(cartpole, Baseline("sac", batch=2), run)
        else:
            train_dreamer(cartpole, DreamerConfig(batch=2), run)
    assert closed


def test_the_best_by_its_live_estimates_is_kept(
    cartpole: SuiteProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also when a training goes on; without estimates it is the last one."""
    monkeypatch.setattr(baselines, "LINE", 64)
    worth, summary = iter([0.1, 0.7, 0.2, 0.3, 0.4]), baselines.summary

    def told(*arguments: object) -> object:
        found = summary(*arguments)  # type: ignore[arg-type]
        found["reward"]["return"]["mean"] = next(worth)
        return found

    monkeypatch.setattr(baselines, "summary", told)
    config = Baseline("ppo", batch=2, window=32, network=NetworkConfig((8,)))
    job = Run(tmp_path / "p", steps=128, starts=3, check=2, check_every=0.0, nthread=1)
    check = train_baseline(cartpole, config, job)["check"]
    assert check == {"episodes": 2, "true_steps": 3 * 16, "reward": 0.7, "step": 128}
    kept = (job.out / "policy.safetensors").read_bytes()
    again = dataclasses.replace(job, steps=192, resume=True)
    check = train_baseline(cartpole, config, again)["check"]
    assert check["reward"] == 0.7 and check["step"] == 128 and check["true_steps"] > 3 * 16
    assert (job.out / "policy.safetensors").read_bytes() == kept


def curve(out: Path) -> list[tuple[int, float | None]]:
    """What a training wrote of its episodes' returns."""
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    return [(row["step"], row.get("return")) for row in rows]


_TRAINING = """
import sys
from pathlib import Path
from orbisim_policies import baselines
from orbisim_policies import baselines
from orbisim_policies.baselines import Baseline, train_baseline
from orbisim_policies.network import NetworkConfig
from orbisim_policies.run import Run
from orbisim_policies.suite import SuiteProblem

baselines.LINE = 100
config = Baseline("ppo", batch=2, window=32, network=NetworkConfig((8,)))
problem = SuiteProblem("cartpole-swingup", steps=8)
out, steps, resume = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "resume"
run = Run(out, steps=steps, starts=3, check=0, nthread=1, save_every=0.0, resume=resume)
train_baseline(problem, config, run)
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_process_that_was_killed_goes_on_exactly(tmp_path: Path) -> None:
    """By a signal that no program can catch, at whatever it does just then."""

    def command(name: str, how: str) -> list[str]:
        return [sys.executable, "-c", _TRAINING, str(tmp_path / name), "2048", how]

    subprocess.run(command("whole", "new"), check=True, timeout=200)
    with subprocess.Popen(command("parts", "new")) as process:
        while process.poll() is None and progress_of(tmp_path / "parts") < 300:
            time.sleep(0.01)
        process.kill()
    assert process.returncode == -signal.SIGKILL, "it was done before it was killed"
    assert not (tmp_path / "parts" / "manifest.json").exists()
    subprocess.run(command("parts", "resume"), check=True, timeout=200)
    weights = [(tmp_path / n / "policy.safetensors").read_bytes() for n in ("whole", "parts")]
    assert weights[0] == weights[1]
    curves = [curve(tmp_path / name) for name in ("whole", "parts")]
    assert curves[0] == curves[1] and len(curves[0]) > 8


def progress_of(out: Path) -> int:
    """The step of the last line of metrics; 0 if there is none."""
    path = out / "metrics.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    return int(json.loads(lines[-1])["step"]) if lines else 0


def test_what_was_seen_is_no_longer_new() -> None:
    curiosity, rng = Curiosity(4), np.random.default_rng(0)
    known, other = rng.normal(size=(64, 4)), rng.normal(size=(64, 4)) + 4
    first = curiosity.reward(known).mean()
    for _ in range(200):
        last = curiosity.reward(known).mean()
    assert last < 0.2 * first and curiosity.reward(other).mean() > 5 * last
