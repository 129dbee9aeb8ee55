"""Controls that make anything move."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from orbisim.tasks.suite_policies import (
    Policy,
    actuated_joints,
    held,
    limits,
    noisy,
    reach,
    rhythm,
    smooth,
)

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody><body><joint name="a"/><geom size=".1"/>
  <body><joint name="b" range="-.5 .5" limited="true"/><geom size=".1"/>
  <body><joint name="passive"/><geom size=".1"/></body></body></body></worldbody>
  <tendon><fixed name="t"><joint joint="b" coef="1"/><joint joint="a" coef="1"/></fixed></tendon>
  <actuator><motor joint="a" ctrlrange="0 4"/><motor tendon="t" ctrlrange="-1 1"/></actuator>
</mujoco>""")
STEP = 0.02


def controls(make: Callable[..., Policy], steps: int = 400, seed: int = 0) -> np.ndarray:
    policy = make(MODEL, np.random.default_rng(seed), STEP)
    data, found = mujoco.MjData(MODEL), []
    for t in range(steps):
        data.time = t * STEP
        found.append(policy(data).copy())
    return np.array(found)


@pytest.mark.parametrize("make", [held, smooth, rhythm, reach])
def test_all_stay_in_range_and_move_about_its_middle(make: Callable[..., Policy]) -> None:
    every = np.concatenate([controls(make, seed=seed) for seed in range(8)])
    low, high = limits(MODEL)
    assert (every >= low).all()
    assert (every <= high).all()
    assert (every.std(axis=0) > 0.02 * (high - low)).all()
    middle = (low + high) / 2
    assert (np.abs(every.mean(axis=0) - middle) < 0.25 * (high - low)).all()


@pytest.mark.parametrize("make", [held, smooth, rhythm, reach])
def test_the_generator_decides_everything(make: Callable[..., Policy]) -> None:
    np.testing.assert_array_equal(controls(make, 50), controls(make, 50))
    assert not np.array_equal(controls(make, 50), controls(make, 50, seed=1))


def test_held_controls_are_held() -> None:
    changes = np.any(np.diff(controls(held, seed=3), axis=0), axis=1)
    assert 0.05 < changes.mean() < 0.9
    assert np.flatnonzero(changes).size > 10


def test_smooth_noise_forgets() -> None:
    """An Ornstein-Uhlenbeck process: consecutive values correlate, distant ones do not."""
    every = [controls(smooth, 2000, seed)[:, 1] for seed in range(6)]

    def correlation(lag: int) -> float:
        return float(np.mean([np.corrcoef(x[:-lag], x[lag:])[0, 1] for x in every]))

    assert correlation(1) > 0.5
    assert abs(correlation(1000)) < 0.2


def test_noise_has_its_size() -> None:
    def still(data: mujoco.MjData) -> np.ndarray:
        return np.array([2.0, 0.0])

    rng = np.random.default_rng(0)
    policy = noisy(still, MODEL, rng, 0.1)
    data = mujoco.MjData(MODEL)
    spread = np.std([policy(data) for _ in range(2000)], axis=0)
    np.testing.assert_allclose(spread, [0.1 * 2, 0.1 * 1], rtol=0.1)


def test_actuated_joints_are_those_of_tendons_too() -> None:
    assert actuated_joints(MODEL).tolist() == [0, 1]


def test_limits_are_those_declared_or_one() -> None:
    low, high = limits(MODEL)
    assert (low.tolist(), high.tolist()) == ([0, -1], [4, 1])
    free = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='j'/><geom size='1'/></body></worldbody>"
        "<actuator><motor joint='j'/></actuator></mujoco>"
    )
    assert [one.tolist() for one in limits(free)] == [[-1.0], [1.0]]
