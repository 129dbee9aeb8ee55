"""AdamW on one flat vector, against torch's own."""

from __future__ import annotations

import torch
from orbisim_world_model.optimizer import FlatAdamW
from orbisim_world_model.schedule import Clock
from orbisim_world_model.trainer import Trainer
from torch import nn

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import PENDULUM, simulate


def test_the_optimizer_is_adamw() -> None:
    trainer = Trainer(simulate(PENDULUM, 3, 12, 2), toy(), Clock(2, None))
    ours = trainer.optimizer
    reference = torch.nn.Parameter(ours.values.clone())
    theirs = torch.optim.AdamW([reference], lr=1e-3, betas=(0.9, 0.98), eps=1e-9, weight_decay=0.0)
    ours.decayed.zero_()
    ours.rate.fill_(1e-3)
    for seed in range(5):
        gradient = torch.randn(len(reference), generator=torch.Generator().manual_seed(seed))
        gradient /= 10 * gradient.norm()
        ours.gradient.copy_(gradient)
        reference.grad = gradient.clone()
        ours.step()
        theirs.step()
    torch.testing.assert_close(ours.values, reference.data, atol=1e-6, rtol=1e-5)


def test_a_gradient_that_is_not_finite_changes_nothing() -> None:
    trainer = Trainer(simulate(PENDULUM, 3, 12, 2), toy(), Clock(2, None))
    before = trainer.optimizer.values.clone()
    trainer.optimizer.rate.fill_(1e-3)
    trainer.optimizer.gradient.fill_(float("nan"))
    trainer.optimizer.step()
    assert torch.equal(trainer.optimizer.values, before)
    trainer.optimizer.gradient.fill_(1.0)
    trainer.optimizer.step()
    assert torch.isfinite(trainer.optimizer.values).all()
    assert not torch.equal(trainer.optimizer.values, before)


def test_a_large_gradient_is_cut() -> None:
    for factor in (10.0, 1000.0):
        torch.manual_seed(0)
        module = nn.Linear(3, 2)
        optimizer = FlatAdamW(module, 0.0, clip=1.0)
        optimizer.rate.fill_(0.1)
        optimizer.gradient.fill_(factor)
        optimizer.step()
        expected = 0.1 / 8**0.5  # (1 - 0.9) times a gradient of norm 1
        torch.testing.assert_close(optimizer.first, torch.full((8,), expected), atol=1e-6, rtol=0)


def test_what_is_restored_goes_on_as_it_would_have() -> None:
    def fresh() -> FlatAdamW:
        torch.manual_seed(0)
        optimizer = FlatAdamW(nn.Linear(3, 2), 0.1, 1.0)
        optimizer.rate.fill_(0.01)
        return optimizer

    def step(optimizer: FlatAdamW, number: int) -> None:
        optimizer.gradient.copy_(torch.sin(torch.arange(8.0) + number))
        optimizer.step()

    one, other = fresh(), fresh()
    for number in range(3):
        step(one, number)
    other.restore({name: tensor.clone() for name, tensor in one.state().items()})
    for optimizer in (one, other):
        step(optimizer, 3)
    torch.testing.assert_close(one.values, other.values, atol=0, rtol=0)
