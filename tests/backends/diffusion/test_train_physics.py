"""PhyInf is trained through the frozen dynamics, or on the true values."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from orbisim_diffusion.checkpoint import PHYSICS, read_manifest
from orbisim_diffusion.config import TrainConfig
from orbisim_diffusion.estimate_physics import load_physics
from orbisim_diffusion.physics import PhysicsInference, Posterior
from orbisim_diffusion.physics_data import Windows
from orbisim_diffusion.train_physics import (
    FreeRuns,
    Objective,
    calibrate,
    physics_errors,
    train_physics,
)
from orbisim_diffusion.training import Run
from orbisim_world_model.packing import read_data
from orbisim_world_model.zoo import located

from orbisim import Recording
from orbisim.cli.main import run
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make
from tests.backends.diffusion.slides import Slides
from tests.backends.diffusion.tiny import save_tiny

QUICK = TrainConfig(batch=32, rate=3e-3, warmup=5, average=0.9)


@pytest.mark.parametrize("objective", ["rollout", "values"])
def test_friction_is_found_where_something_slides_and_not_where_nothing_does(
    objective: Objective,
) -> None:
    torch.manual_seed(0)
    world: Any = Slides()
    found, _ = train_physics(objective, Run(1e9, 50), world, world, training=QUICK)
    truth = world.draw(128)  # fresh: the first half moves
    with torch.no_grad():
        said = found.said(world.seen(truth))
    off = (said.mean - truth.logs)[:, 0].abs()
    blind = (found.middle[0] - truth.logs[:, 0]).abs()
    share = said.spread / found.prior[found.kinds(2), 1]
    # a transformer over tokens of 4 frames, which had to find out what a deceleration is, left 0.8
    # and 0.6 of the prior's error after as many steps, and nothing learned of real pushes
    assert float(off[:64].mean()) < 0.2 * float(blind[:64].mean())
    assert float(share[:64, 0].mean()) < 0.3 and float(share[64:, 0].mean()) > 0.95
    assert float((said.mean - found.middle[0])[64:, 0].abs().mean()) < 0.05 * found.width[0]
    assert float(share[:, 1:].mean()) > 0.8  # densities show nowhere


def test_spreads_are_widened_until_they_are_right() -> None:
    class Sure(PhysicsInference):
        """Always answers the prior's middle, ten times as sure as it may be."""

        def forward(self, window: Any) -> Any:
            found = super().forward(window)
            return found._replace(spread=found.spread / 10.0)

    torch.manual_seed(0)
    model, world = Sure().eval(), Slides()
    model.know(world.pack.world[:, 0], torch.tensor([200.0, 400.0, 800.0]))
    calibrate(model, cast(Windows, world))
    assert 7.0 < float(model.widen[0]) <= 10.0  # 95 % of even draws: 1.65 deviations, not 1.96


def test_training_goes_on_with_what_was_learned_before() -> None:
    torch.manual_seed(0)
    world: Any = Slides()
    begun = PhysicsInference()
    begun.know(torch.tensor([0.1, 0.3]), torch.tensor([100.0, 900.0]))
    torch.nn.init.normal_(begun.head.weight)
    late = TrainConfig(batch=32, rate=1e-6, warmup=1, average=0.0)
    found, _ = train_physics("values", Run(1e9, 1), world, world, training=late, start=begun)
    torch.testing.assert_close(found.head.weight, begun.head.weight, atol=1e-5, rtol=0)
    assert torch.equal(found.prior, begun.prior)


def test_what_it_gains_over_the_prior_is_stated_with_an_interval() -> None:
    class Halved(PhysicsInference):
        """Answers the prior, and is twice as sure."""

        def forward(self, window: Any) -> Posterior:
            rows = self.prior[self.kinds(2)].expand(len(window.known), 3, 2)
            return Posterior(rows[..., 0], rows[..., 1] / 2.0)

    torch.manual_seed(0)
    model, world = Halved().eval(), Slides()
    model.know(world.pack.world[:, 0], torch.tensor([200.0, 400.0, 800.0]))
    found = physics_errors(model, cast(Windows, world))
    # of a normal distribution as wide as the prior: ln 2 - (4 - 1) / 2
    expected = math.log(2.0) - 1.5
    assert found["friction_moving_gain"] == pytest.approx(expected, abs=0.15)
    low, high = found["friction_moving_gain_low"], found["friction_moving_gain_high"]
    assert low < found["friction_moving_gain"] < high and 0.05 < high - low < 0.5


def test_free_runs_are_the_frozen_steps_and_have_its_gradients(tmp_path: Path) -> None:
    path = tmp_path / "push.h5"
    collect("push", path, episodes=2, workers=1, seed=4)
    pack = read_data([path])
    free, windows = FreeRuns(pack, located("push"), torch.device("cpu")), Windows(pack)
    truth = windows.at(torch.tensor([0, 1]), pack.start[:2] + 30)
    values = truth.logs.exp().requires_grad_()
    errors, moves = free(truth, values)
    assert errors.shape == (2, 3, 21, 2, 2, 3) and moves.shape == (2, 3, 2)
    assert float(errors[:, :, 0, :, 0].detach().abs().max()) < 0.003  # a step from a true state
    moved = pack.states(truth.first[:, None] + torch.arange(64)).pos.unflatten(0, (2, 64))
    far = (moved[:, 1:] - moved[:, :-1]).norm(dim=-1).unflatten(1, (3, 21)).sum(2)
    assert torch.equal(moves > 0, far > 0.005) and bool(moves.any())
    errors.square().sum().backward()
    assert values.grad is not None and bool(torch.isfinite(values.grad).all())
    assert float(values.grad[:, 0].abs().max()) > 0
    wrong = values.detach() * torch.tensor([1.5, 1.0, 1.0])
    there = moves[:, :, None, :, None, None] > 0
    change = (free(truth, wrong)[0] - errors.detach()).abs()
    assert float((change * there).amax()) > 1e-3  # friction is felt by what moves


@pytest.mark.slow
def test_the_command_adds_it_and_states_its_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, folder = tmp_path / "push.h5", save_tiny(tmp_path / "look", make("push").scene())
    collect("push", data, episodes=4, workers=1)
    command = ["train", "inference", str(folder), str(data), "--steps", "1", "--device", "cpu"]
    assert run([*command, "--physics", "--json"]) == 0
    metrics = json.loads(capsys.readouterr().out)["metrics"]
    assert metrics["objective"] == "rollout" and metrics["windows"] > 0
    manifest = read_manifest(folder)
    assert manifest["metrics"][PHYSICS] == metrics
    _, reach = load_physics(folder)
    assert (reach.dynamics, reach.surface, reach.hand) == ("push", "table", "tcp")
    assert manifest["files"][PHYSICS]["bytes"] < 1.5e6
    frames = EpisodeFile(data).episode(0, ["qpos", "ctrl"])
    time = 0.05 * np.arange(64)
    Recording(time, {n: v[:64] for n, v in frames.items()}).save(tmp_path / "seen.npz")
    fit = ["identify", "task:push", str(tmp_path / "seen.npz"), "--params", "friction:table"]
    assert run([*fit, "--guess", str(folder), "--steps", "1", "--json"]) == 0
    row = json.loads(capsys.readouterr().out)["parameters"]["friction:table"]
    assert row["ci95"][0] <= row["value"] <= row["ci95"][1]
    assert run([*fit, "--guess", str(tmp_path)]) == 2
    assert run([*command, "--objective", "values"]) == 2
    assert "--physics" in capsys.readouterr().err
