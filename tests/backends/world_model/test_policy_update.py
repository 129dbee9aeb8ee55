from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from orbisim_world_model.dynamics import Dynamics, example
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.policy_update import PolicyUpdate
from orbisim_world_model.trainer import new_model
from torch import nn

from orbisim import load_scene, make_backend
from orbisim.errors import InputError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate

CPU = torch.device("cpu")
WORLDS, WINDOW = 3, 4


class Joints(nn.Module):
    def __init__(self, joints: int, controls: int) -> None:
        super().__init__()
        self.layer = nn.Linear(joints, controls)

    def forward(self, x: Entities) -> torch.Tensor:
        found: torch.Tensor = self.layer(x.q)
        return found


def _far(x: Entities) -> torch.Tensor:
    return (x.q - 0.3).square().sum(1)


@pytest.fixture(scope="module")
def model() -> Dynamics:
    made = new_model(simulate(TABLE, 4, 20, 4), toy(), 0).eval()
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator)
    return made


def _start(model: Dynamics) -> tuple[Entities, Context]:
    x, context = example(model.layout, WORLDS)
    attributes = model.see_attributes.mean.expand_as(context.attributes).clone()
    world = model.see_world.mean.expand_as(context.world).clone()
    q = 0.1 * torch.randn(x.q.shape, generator=torch.Generator().manual_seed(2))
    return x._replace(q=q), Context(attributes, world, None)


def test_its_gradient_is_that_of_the_steps(model: Dynamics) -> None:
    torch.manual_seed(0)
    x, context = _start(model)
    policy = Joints(x.q.shape[1], model.controls)
    other = copy.deepcopy(policy)
    update = PolicyUpdate(model, policy, _far, context, CPU, window=WINDOW, rate=0.0)
    loss = update(x)
    now, memory = model.completed(x), model.initial_memory(WORLDS)
    for _ in range(WINDOW):
        after = model(now, memory, other(now), context)
        now, memory = after.state, after.memory
    wanted = _far(now).mean()
    wanted.backward()
    torch.testing.assert_close(loss, wanted.detach(), rtol=1e-4, atol=1e-6)
    for mine, theirs in zip(policy.parameters(), other.parameters(), strict=True):
        torch.testing.assert_close(mine.grad, theirs.grad, rtol=1e-3, atol=1e-6)


def test_the_loss_falls(model: Dynamics) -> None:
    torch.manual_seed(0)
    x, context = _start(model)
    policy = Joints(x.q.shape[1], model.controls)
    update = PolicyUpdate(model, policy, _far, context, CPU, window=WINDOW, rate=3e-2)
    losses = [float(update(x)) for _ in range(8)]
    assert losses[-1] < losses[0]


def test_the_backend_offers_it() -> None:
    backend = make_backend("learned", load_scene("task:push"), nworld=2, device="cpu")
    state = backend.reset(2)
    policy = Joints(8, 7)
    update = backend.policy_update(state, policy, lambda x: x.pos.square().sum((1, 2)), window=2)
    before = policy.layer.weight.detach().clone()
    assert update(backend.entities(state)).isfinite()
    assert not torch.equal(policy.layer.weight, before)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"window": 0}, "window"),
        ({"rate": -1e-3}, "rate must be a finite number of at least 0; got -0.001"),
        ({"rate": float("nan")}, "rate must be .*got nan"),
        ({"policy": nn.Identity()}, "no parameters"),
    ],
)
def test_arguments_that_make_no_sense(
    model: Dynamics, changes: dict[str, Any], message: str
) -> None:
    x, context = _start(model)
    given = {"policy": Joints(x.q.shape[1], model.controls), "window": WINDOW, **changes}
    policy = given.pop("policy")
    with pytest.raises(InputError, match=message):
        PolicyUpdate(model, policy, _far, context, CPU, **given)


def test_states_policies_and_losses_of_another_shape(model: Dynamics) -> None:
    x, context = _start(model)

    def update(wide: int = 0, loss: Any = _far) -> PolicyUpdate:
        policy = Joints(x.q.shape[1], model.controls + wide)
        return PolicyUpdate(model, policy, loss, context, CPU, window=WINDOW)

    one = update()
    one(x)
    with pytest.raises(InputError, match="states are of 1 worlds; descriptors are of 3"):
        one(x.at(slice(1)))
    with pytest.raises(InputError, match=r"controls of shape \(3, 3\); expected \(3, 2\)"):
        update(wide=1)(x)
    with pytest.raises(InputError, match=r"values of shape \(\); expected \(3,\)"):
        update(loss=lambda x: _far(x).sum())(x)


def test_a_gradient_that_is_not_finite_changes_nothing(model: Dynamics) -> None:
    x, context = _start(model)
    policy = Joints(x.q.shape[1], model.controls)
    update = PolicyUpdate(model, policy, _far, context, CPU, window=WINDOW)
    before = policy.layer.weight.detach().clone()
    assert update(x._replace(q=x.q * float("nan"))).isnan()
    assert torch.equal(policy.layer.weight, before) and int(update.optimizer.skipped) == 1
