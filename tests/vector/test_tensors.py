"""Dictionaries of tensors as TorchRL has them."""

from __future__ import annotations

import pytest

import orbisim
from orbisim.errors import InputError

torch = pytest.importorskip("torch")


def test_steps_and_resets() -> None:
    environment = orbisim.vector.load(
        "cartpole", "balance", 3, seed=0, task_kwargs={"time_limit": 0.03}, arrays="torch"
    )
    tensors = orbisim.vector.TensorEnvironment(environment)
    first = tensors.reset()
    assert first["position"].shape == (3, 3) and not first["done"].any()
    action = torch.zeros((3, 1))
    for _ in range(3):
        after = tensors.step({**first, "action": action})
    assert after["action"] is action
    then = after["next"]
    assert {n: tuple(t.shape) for n, t in then.items()} == {
        "position": (3, 3),
        "velocity": (3, 2),
        "reward": (3, 1),
        "terminated": (3, 1),
        "truncated": (3, 1),
        "done": (3, 1),
    }
    assert then["done"].all() and not then["terminated"].any()
    again = tensors.reset({"_reset": torch.tensor([[False], [True], [False]])})
    assert torch.equal(again["position"][0], then["position"][0])
    assert environment.state.time[1] == 0.0 and environment.state.time[0] > 0.0


def test_what_it_cannot_take() -> None:
    with pytest.raises(InputError, match="arrays='torch'"):
        orbisim.vector.TensorEnvironment(orbisim.vector.load("cartpole", "balance", 2))
    environment = orbisim.vector.load("cartpole", "balance", 2, arrays="torch")
    with pytest.raises(InputError, match="needs 'action'"):
        orbisim.vector.TensorEnvironment(environment).step({})
