"""The timestep of a scene, as recordings take it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.stepping import Stepping, stepping, with_stepping
from orbisim.shooting.timestep import (
    exact,
    held,
    is_exact,
    lengths,
    peak,
    stepped,
    taken,
    typical_interval,
)
from orbisim.testing import inject_effect


@pytest.mark.parametrize(
    ("left", "place"),
    [
        ({0.0: 2.0, 0.05: 1.81, 0.5: 1.0}, 0.5),  # 2 - 4 s (1 - s): where it is known
        ({0.0: 9.0, 0.05: 5.5, 0.5: 19.0}, 0.2),  # 9 - 80 s + 200 s²
        ({0.0: 30.0, 0.05: 27.55, 0.5: 10.0}, 1.0),  # 30 - 50 s + 20 s²: within an interval
        ({0.0: 2.0, 0.05: np.inf, 0.5: 1.0}, None),
        ({0.0: 30.0, 0.05: 29.0, 0.5: 10.0}, None),  # the steeper the further: no lowest point
    ],
)
def test_the_next_share_is_a_parabolas_peak(left: dict[float, float], place: float | None) -> None:
    found = peak({at: -float(np.log(one)) for at, one in left.items()}, 0.0, 1.0)
    assert found == (None if place is None else pytest.approx(place, abs=0.02))


def test_a_sampling_interval_has_a_whole_number_of_steps(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], rate=100.0, duration=1.0, episodes=1, noise=1e-3, seed=0)
    bench = make_bench(arm, prepare_all(runs, arm), 0.3)
    assert typical_interval(bench) == pytest.approx(0.01)
    for asked, expected in ((0.002, 0.002), (0.003, 0.0025), (0.03, 0.01)):
        assert taken(bench, asked) == pytest.approx(expected)
    assert taken(bench) == pytest.approx(float(arm.model.opt.timestep))


def test_exact_steps_divide_the_sampling_interval(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], rate=100.0, duration=1.0, episodes=1, noise=1e-3, seed=0)
    euler = with_stepping(arm, Stepping(0.003, int(mujoco.mjtIntegrator.mjINT_EULER)))
    bench = make_bench(euler, prepare_all(runs, euler), 0.3)
    other = exact(bench, 4)
    assert is_exact(other) and not is_exact(bench)
    found = stepping(other.scene)
    assert found.integrator == int(mujoco.mjtIntegrator.mjINT_RK4)
    assert found.timestep == pytest.approx(0.0025)  # four make an interval of 10 ms
    own = held(other, 0.001)
    assert stepping(own.scene).integrator == int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    assert stepping(own.scene).timestep == pytest.approx(0.001)
    between = held(other, 0.0011)  # nine make an interval
    assert stepping(between.scene).timestep == pytest.approx(0.01 / 9)
    same = stepping(held(bench, 0.001).scene)  # by the integrator that there is
    assert same.integrator == int(mujoco.mjtIntegrator.mjINT_EULER)
    assert same.timestep == pytest.approx(0.001)


def test_lengths_to_try_lie_to_either_side_of_the_step(arm: orbisim.Scene) -> None:
    """Instead of exact ones, those that simulations have; never a step beyond an interval."""
    runs = inject_effect(arm, [], rate=100.0, duration=1.0, episodes=1, noise=1e-3, seed=0)
    bench = make_bench(arm, prepare_all(runs, arm), 0.3)
    assert lengths(exact(bench, 1)) == pytest.approx((0.01 / 16, 0.01 / 8))
    assert lengths(stepped(bench, 0.0025)) == pytest.approx((0.002, 0.01 / 3))
    assert lengths(stepped(bench, 0.01)) == pytest.approx((0.005,))
