"""Many worlds as a `gymnasium.vector.VectorEnv`."""

from __future__ import annotations

import numpy as np
import pytest

import orbisim
from orbisim.errors import InputError

gymnasium = pytest.importorskip("gymnasium")


@pytest.mark.parametrize(("domain", "task"), [("cartpole", "swingup"), ("walker", "walk")])
def test_is_a_vector_env(domain: str, task: str) -> None:
    env = orbisim.vector.gym(domain, task, 3, seed=0, task_kwargs={"time_limit": 0.1})
    assert isinstance(env, gymnasium.vector.VectorEnv)
    assert env.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    observation, info = env.reset(seed=1)
    assert observation in env.observation_space and info == {}
    env.action_space.seed(0)
    ends = 0
    for _ in range(30):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert reward.shape == terminated.shape == truncated.shape == (3,)
        ends += truncated.sum()
    assert ends
    env.close()


def test_seeds_as_gymnasium_gives_them() -> None:
    env = orbisim.vector.gym("cartpole", "balance", 3)
    first, _ = env.reset(seed=4)
    second, _ = env.reset(seed=[4, 5, 6])
    np.testing.assert_array_equal(first["position"], second["position"])
    with pytest.raises(InputError, match="reset knows no options"):
        env.reset(options={"angle": 1})


def test_flat_observations_are_one_box() -> None:
    env = orbisim.vector.gym("cheetah", "run", 2, environment_kwargs={"flat_observation": True})
    assert isinstance(env.single_observation_space, gymnasium.spaces.Box)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (2, 17)


def test_wrappers_of_gymnasium() -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        orbisim.vector.gym("cartpole", "balance", 2, seed=0, task_kwargs={"time_limit": 0.05})
    )
    env.reset()
    infos = [env.step(np.zeros((2, 1)))[-1] for _ in range(5)]
    assert infos[-1]["episode"]["l"].tolist() == [5, 5]


def test_divergence_is_in_the_info() -> None:
    env = orbisim.vector.gym("cartpole", "balance", 2, seed=0)
    env.reset()
    *_, info = env.step(np.array([[np.nan], [0.0]]))
    assert info["diverged"].tolist() == [True, False]


def test_a_loaded_environment() -> None:
    environment = orbisim.vector.load("cartpole", "balance", 2)
    assert orbisim.vector.gym(environment).environment is environment
    with pytest.raises(InputError, match="takes nothing else"):
        orbisim.vector.gym(environment, "balance")
    tensors = orbisim.vector.load("cartpole", "balance", 2, arrays="torch")
    with pytest.raises(InputError, match="arrays='numpy'"):
        orbisim.vector.gym(tensors)
