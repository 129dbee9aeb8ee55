"""Short episodes: three control steps of pushing, eight of the cart-pole."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from orbisim_policies.films import Films
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SuiteProblem

FILMED = [11, 12, 13]
"""Seeds of the filmed episodes."""


@pytest.fixture(scope="session")
def push() -> PushProblem:
    return PushProblem(steps=3)


@pytest.fixture(scope="session")
def cartpole() -> SuiteProblem:
    return SuiteProblem("cartpole-swingup", steps=8)


@pytest.fixture(scope="session")
def push_worlds(push: PushProblem) -> LearnedWorlds:
    return LearnedWorlds(push, None, torch.device("cpu"))


@pytest.fixture(scope="session")
def cartpole_worlds(cartpole: SuiteProblem) -> LearnedWorlds:
    return LearnedWorlds(cartpole, None, torch.device("cpu"))


@pytest.fixture
def films(push: PushProblem) -> Films:
    """Films of arms that stand still, read with errors that are known."""
    rng = np.random.default_rng(0)
    starts = push.draw(FILMED)
    nv = starts.qvel.shape[1]

    def each(values: Any) -> Any:
        return np.repeat(values[:, None], push.steps, axis=1)

    true = each(starts.qpos)
    read = true + rng.normal(0, 0.003, true.shape)
    for a in (11, 18):  # quaternions of the cubes
        read[..., a : a + 4] /= np.linalg.norm(read[..., a : a + 4], axis=-1, keepdims=True)
    params = push.unseen(torch.as_tensor(starts.params)).double().numpy()
    return Films(
        seeds=np.array(FILMED),
        success=np.array([True, False, True]),
        true_qpos=true,
        true_qvel=np.zeros((len(FILMED), push.steps, nv)),
        qpos=read,
        qvel=rng.normal(0, 0.05, (len(FILMED), push.steps, nv)),
        seen=np.ones((len(FILMED), push.steps, 2), bool),
        ctrl=each(starts.ctrl),
        command=each(starts.command),
        action=rng.uniform(-1, 1, (len(FILMED), push.steps, push.actions)),
        params=params,
        notes={"task": push.name, "observe": "stainf", "camera": "side"},
    )
