"""Many worlds as a Stable-Baselines3 `VecEnv`."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.errors import InputError

sb3 = pytest.importorskip("stable_baselines3")


def made(flat: bool = True, **options: Any) -> Any:
    kwargs = {"flat_observation": True} if flat else {}
    return orbisim.vector.StableBaselinesVecEnv(
        orbisim.vector.load(
            "cartpole",
            "balance",
            3,
            seed=0,
            task_kwargs={"time_limit": 0.05},
            environment_kwargs=kwargs,
            **options,
        )
    )


@pytest.mark.parametrize("flat", [True, False])
def test_worlds_are_reset_in_the_step_that_ends_them(flat: bool) -> None:
    env = made(flat)
    env.seed(5)
    first = env.reset()
    for number in range(5):
        observation, reward, done, infos = env.step(np.zeros((3, 1)))
        assert done.all() == (number == 4)
    assert reward.dtype == np.float32 and infos[0]["TimeLimit.truncated"]
    assert env.environment.state.time.tolist() == [0.0, 0.0, 0.0]
    last, one = infos[1]["terminal_observation"], observation
    if not flat:
        last, one, first = last["position"], one["position"], first["position"]
    assert not np.array_equal(last, one[1])
    env.seed(5)
    again = env.reset()
    np.testing.assert_array_equal(again if flat else again["position"], first)
    assert not np.array_equal(one, first)


def test_a_policy_is_trained() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = sb3.PPO("MlpPolicy", made(), n_steps=8, batch_size=12, n_epochs=1, device="cpu")
        model.learn(48)
    assert model.num_timesteps == 48


def test_wrappers_of_stable_baselines() -> None:
    env = sb3.common.vec_env.VecMonitor(made())
    env.reset()
    infos = [env.step(np.zeros((3, 1)))[-1] for _ in range(5)][-1]
    assert [info["episode"]["l"] for info in infos] == [5, 5, 5]


def test_divergence_is_in_the_infos() -> None:
    env = made()
    env.reset()
    *_, done, infos = env.step(np.array([[0.0], [np.nan], [0.0]]))
    assert done.tolist() == [False, True, False]
    assert infos[1]["diverged"] and "diverged" not in infos[0]


def test_what_worlds_do_not_have() -> None:
    env = made()
    assert env.get_attr("nworld", [0, 2]) == [3, 3]
    assert env.env_is_wrapped(object) == [False, False, False]
    with pytest.raises(InputError, match="no attribute 'gain'"):
        env.set_attr("gain", 1)
    with pytest.raises(InputError, match="no method 'kick'"):
        env.env_method("kick")
    with pytest.raises(InputError, match="arrays='numpy'"):
        made(arrays="torch")
