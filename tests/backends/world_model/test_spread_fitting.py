"""A spread is trained on rollouts of a finished model and calibrated on others."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from orbisim_world_model.checkpoint import load_checkpoint, save_checkpoint
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.pack import Pack
from orbisim_world_model.run import Run, train
from orbisim_world_model.spread import FLOOR, calibration_of
from orbisim_world_model.spread_fitting import (
    Rollouts,
    SpreadRun,
    deviations,
    fit_spread,
    rollouts,
    spread_loss,
)
from orbisim_world_model.trainer import new_model

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate


@pytest.fixture(scope="module")
def pack() -> Pack:
    return simulate(TABLE, 8, 25, 4)


@pytest.fixture(scope="module")
def model(pack: Pack) -> Dynamics:
    return new_model(pack, toy(), 0)


def test_rollouts_begin_at_the_truth(model: Dynamics, pack: Pack) -> None:
    data = rollouts(model.eval(), pack, 6, 10, 0)
    assert data.errors.shape == (6, 10, 3, 2) and data.mask.shape == (10, 3)
    first = data.states.at(0)
    near = (pack.qpos[:, None, 0] - first.q[None, :, 0]).abs().amin(0)
    assert near.max() < 1e-6  # a state of the data
    step = model(first, model.initial_memory(10), data.control[0], data.context)
    for a, b in zip(step.state, data.states.at(1), strict=True):
        assert torch.allclose(a, b, atol=1e-6)
    again = rollouts(model, pack, 6, 10, 0)
    assert torch.equal(again.errors, data.errors)


def test_the_loss_is_least_near_the_errors_size() -> None:
    generator = torch.Generator().manual_seed(0)
    errors = 2.0 * torch.randn(5, 400, 1, 2, generator=generator).abs()
    data = Rollouts(None, None, errors, None, torch.ones(400, 1))  # type: ignore[arg-type]
    losses = [float(spread_loss(torch.full_like(errors, s), data)) for s in (0.5, 1.7, 8.0)]
    assert losses[1] < min(losses[0], losses[2])


def test_intervals_cover_nine_in_ten_and_tell_small_errors_from_large(
    model: Dynamics, pack: Pack
) -> None:
    run = SpreadRun(steps=80, windows=48, batch=16, length=12, width=16)
    known = fit_spread(model, [pack], [pack], run)
    assert known["width"] == 16 and known["floor"] == FLOOR and known["steps"] == 80
    data = rollouts(model, pack, 12, 64, 5)
    with torch.no_grad():
        sizes = deviations(model, data)
    late = (data.errors <= sizes * calibration_of(known, pack.layout).factors)[6:]
    for covered in (late[:, :, :1], late[:, :, 1:]):
        assert (covered.float().mean((0, 1, 2)) - 0.9).abs().max() < 0.09
    order = [t.log().flatten().clamp_min(-9.0) for t in (sizes[..., 0], data.errors[..., 0])]
    assert torch.corrcoef(torch.stack(order))[0, 1] > 0.5


def test_episodes_of_other_lengths_take_turns(model: Dynamics, pack: Pack) -> None:
    short = simulate(TABLE, 4, 8, 4)
    run = SpreadRun(steps=4, windows=24, batch=6, width=16)
    known = fit_spread(model, [short, pack], [short, pack], run)
    assert all(value > 0 for pair in known["factor"].values() for value in pair)
    only = fit_spread(model, [short, pack], [short], run)
    assert known["factor"]["objects"] != only["factor"]["objects"]  # the long ones count


def test_deviations_are_no_smaller_than_the_floor(model: Dynamics, pack: Pack) -> None:
    data = rollouts(model.eval(), pack, 3, 4, 0)
    spread = model.with_spread(8).spread
    assert spread is not None
    torch.nn.init.constant_(spread.noise.bias, -20.0)
    with torch.no_grad():
        fine, coarse = (deviations(model, data, floor) for floor in (1e-3, 2.0))
        assert torch.equal(deviations(model, data), deviations(model, data, FLOOR))
    model.spread = None
    assert ((fine >= 1e-3) & (fine < 2e-3)).all()  # e^-20 and its sum add next to nothing
    torch.testing.assert_close(coarse, torch.full_like(coarse, 2.0))


def test_a_limit_of_seconds_ends_it(model: Dynamics, pack: Pack) -> None:
    run = SpreadRun(steps=1_000_000, limit=0.3, windows=8, batch=4, length=4, width=8)
    assert 1 <= fit_spread(model, [pack], [pack], run)["steps"] < 10_000


def test_a_training_that_goes_on_leaves_the_uncertainty_out(pack: Pack, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    train(pack, toy(), Run(out=first, steps=1, horizons=(5,), burn=2))
    made = load_checkpoint(first)
    known = fit_spread(made.model, [pack], [pack], SpreadRun(2, 4, windows=8, length=4, width=8))
    save_checkpoint(first, [made.model], {**made.manifest, "uncertainty": known})
    assert load_checkpoint(first).model.spread is not None
    train(pack, toy(), Run(out=second, steps=1, start=first, horizons=(5,), burn=2))
    assert load_checkpoint(second).model.spread is None
