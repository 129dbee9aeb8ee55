"""Short episodes: three control steps of pushing, eight of the cart-pole."""

from __future__ import annotations

import pytest
import torch
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SuiteProblem


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
