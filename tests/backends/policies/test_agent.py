from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_policies.agent import Agent
from orbisim_policies.checkpoint import save_policy
from orbisim_policies.evaluate import in_mujoco
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.push import PushProblem

from orbisim import make_backend
from orbisim.errors import InputError


@pytest.fixture(scope="module")
def folder(push: PushProblem, tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    policy = Policy(push.observations, push.actions, NetworkConfig((8,)))
    with torch.no_grad():
        policy.head.bias.copy_(torch.tensor([0.3, 0.2, -1.0, 0.0]))
    path = tmp_path_factory.mktemp("policy")
    save_policy(path, policy, push, {})
    return path


def test_a_policy_acts_in_any_backend_as_in_an_evaluation(push: PushProblem, folder: Path) -> None:
    agent = Agent.of(folder, "task:push")
    setup = agent.episodes(2, 5)
    ends, reached = {}, []
    for name, device in (("mujoco", None), ("learned", "cpu")):
        engine = make_backend(name, setup.scene, nworld=2, device=device)
        trajectory = agent.act(engine, setup, push.steps * push.timestep)
        ends[name] = np.asarray(trajectory.final.qpos)
        reached.append(agent.result(trajectory)["r1"])
    assert reached[0] == pytest.approx(reached[1], abs=0.02)
    assert agent.starts is not None
    expected, _, _ = in_mujoco(push, agent.policy, agent.starts, nthread=1)
    np.testing.assert_allclose(ends["mujoco"], expected, atol=1e-5)
    np.testing.assert_allclose(ends["learned"], expected, atol=0.02)


def test_a_policy_for_another_scene_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="another scene"):
        Agent.of(folder, "suite:cartpole-swingup")
