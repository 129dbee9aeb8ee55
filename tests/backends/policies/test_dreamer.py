from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch
from orbisim_policies.checkpoint import load_policy, read_manifest
from orbisim_policies.dreamer import Dreamer, DreamerConfig, _mean, _surprise, train_dreamer
from orbisim_policies.evaluate import in_mujoco, starts_of
from orbisim_policies.latent import LatentConfig, LatentPolicy
from orbisim_policies.run import Run
from orbisim_policies.suite import SuiteProblem

from orbisim.errors import InputError
from tests.backends.policies.known import Slide

SMALL = DreamerConfig(
    batch=2,
    sequences=4,
    length=6,
    ratio=8.0,
    imagined=3,
    capacity=200,
    sizes=LatentConfig(units=16, layers=1, deter=16, variables=4, classes=4),
)


def test_rewards_are_told_by_bins() -> None:
    bins = torch.linspace(-20.0, 20.0, 255)
    value = torch.tensor([-2.0, 0.0, 0.31, 1.7, 250.0])
    logits = torch.zeros((5, 255), requires_grad=True)
    optimizer = torch.optim.Adam([logits], 0.3)
    for _ in range(300):
        optimizer.zero_grad()
        _surprise(logits, value, bins).sum().backward()
        optimizer.step()
    torch.testing.assert_close(_mean(logits, bins).detach(), value, rtol=0.03, atol=0.02)


def test_moments_are_kept_as_they_came(cartpole: SuiteProblem) -> None:
    """An episode's end and the next one's beginning are two moments; a cut is no end."""
    trainer = Dreamer(cartpole, SMALL, cartpole.draw(range(3)), nthread=1)
    for _ in range(cartpole.steps + 1):
        trainer.step(0.0)
    assert trainer.true_steps == 2 * (cartpole.steps + 1)
    assert trainer.replay.count.tolist() == [cartpole.steps + 3] * 2  # and two firsts
    view, action, reward, first, over = trainer.replay.rows[0].split((5, 1, 1, 1, 1), -1)
    assert first[:, 0].nonzero().flatten().tolist() == [0, cartpole.steps + 1]
    assert not over.any() and (reward[1 : cartpole.steps + 1] > 0).all()
    assert not action[0] and not action[cartpole.steps + 1] and action[cartpole.steps].any()
    assert not torch.equal(view[cartpole.steps], view[cartpole.steps + 1])
    trainer.episodes.close()


def test_a_training_goes_on_exactly(cartpole: SuiteProblem, tmp_path: Path) -> None:
    """In the middle of an episode, with what it has seen in it."""
    whole = Run(tmp_path / "whole", steps=60, starts=3, check=0, nthread=1, log_every=5)
    parts = dataclasses.replace(whole, out=tmp_path / "parts", steps=38)
    manifest = train_dreamer(cartpole, SMALL, whole)
    train_dreamer(cartpole, SMALL, parts)
    train_dreamer(cartpole, SMALL, dataclasses.replace(parts, steps=60, resume=True))
    weights = [(run.out / "policy.safetensors").read_bytes() for run in (whole, parts)]
    assert weights[0] == weights[1]
    assert manifest["true_steps"] == 60 and manifest["method"] == "dreamer"
    assert read_manifest(parts.out)["true_steps"] == 60
    policy = load_policy(whole.out, cartpole)
    assert isinstance(policy, LatentPolicy)
    _, value, lost = in_mujoco(cartpole, policy, starts_of(cartpole, 2, 0), 1)
    assert not lost and value.shape == (2, 1)
    with pytest.raises(InputError, match="other settings"):
        other = dataclasses.replace(SMALL, rate=1.0)
        train_dreamer(cartpole, other, dataclasses.replace(whole, resume=True))


@pytest.mark.slow
def test_it_learns_a_task_whose_best_policy_is_known() -> None:
    problem = Slide()
    starts = starts_of(problem, 64, 0)

    def reward(act: object) -> float:
        return float(in_mujoco(problem, act, starts, 1)[1].mean())  # type: ignore[arg-type]

    best, still = reward(lambda view: view[:, :1] / 0.1), reward(lambda view: 0 * view[:, :1])
    sizes = LatentConfig(units=48, layers=1, deter=48, variables=8, classes=8)
    config = DreamerConfig(
        batch=8,
        sequences=16,
        length=10,
        imagined=8,
        rate=2e-3,
        discount=0.95,
        capacity=4000,
        sizes=sizes,
    )
    trainer = Dreamer(problem, config, problem.draw(range(64)), nthread=1)
    for _ in range(320):
        trainer.step(0.0)
    assert reward(trainer.chosen) > still + 0.75 * (best - still)
    trainer.episodes.close()
