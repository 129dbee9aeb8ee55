"""Held controls, windows, states between steps, initial activations and delays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import orbisim
from orbisim import Recording, load_scene
from orbisim.errors import InputError
from orbisim.recording import bind, capture
from orbisim.recording import quaternions as quat
from orbisim.recording.initial import activations, histories, starts
from orbisim.recording.interpolation import Between, linear, positions
from orbisim.recording.windows import Rows, cut
from orbisim.recording.zero_order_hold import Held, filled

from .scenes import EVERYTHING, PENDULUM

times = st.lists(st.floats(1e-4, 0.1), min_size=2, max_size=20).map(np.cumsum)


# -- controls --------------------------------------------------------------------------------------


@given(times, st.floats(1e-3, 0.05), st.integers(0, 5), st.integers(1, 40), st.integers(0, 9))
@settings(deadline=None)
def test_impulse_is_kept(time, step, first, count, seed):
    """Sum of the steps' averages is the integral of the held signal."""
    values = np.random.default_rng(seed).standard_normal((len(time), 2))
    held = Held(time, values)
    start = float(time[0])
    means = held.means(start, step, first, count)
    fine = np.linspace(start + first * step, start + (first + count) * step, 20001)
    middle = held.at((fine[1:] + fine[:-1]) / 2)
    integral = (middle * np.diff(fine)[:, None]).sum(axis=0)
    np.testing.assert_allclose(means.sum(axis=0) * step, integral, atol=2e-3 * step * count)


@given(st.integers(1, 8), st.floats(0, 1e9), st.integers(2, 60))
def test_steps_between_two_samples_get_the_value_itself(ratio, start, count):
    step = 2e-3
    time = start + step * ratio * np.arange(count)
    if np.spacing(start) > 1e-7 * step:
        return
    values = np.random.default_rng(0).standard_normal((count, 1))
    means = Held(time, values).means(start, step, 0, ratio * (count - 1))
    np.testing.assert_array_equal(means, np.repeat(values[:-1], ratio, axis=0))


def test_before_and_after():
    held = Held(np.array([1.0, 2.0]), np.array([[3.0], [4.0]]))
    np.testing.assert_array_equal(
        held.at(np.array([0.0, 1.0, 1.9, 2.0, 9.0]))[:, 0], [3, 3, 3, 4, 4]
    )
    np.testing.assert_allclose(held.means(1.5, 1.0, 0, 2)[:, 0], [3.5, 4.0])


def test_filled():
    values = np.array([[np.nan, np.nan], [1, np.nan], [np.nan, np.nan], [2, np.nan]])
    np.testing.assert_array_equal(filled(values)[:, 0], [1, 1, 1, 2])
    assert np.isnan(filled(values)[:, 1]).all()


# -- windows ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time", "duration", "expected"),
    [
        (np.arange(1001) * 1e-3, 0.5, [Rows(0, 501), Rows(500, 1001)]),
        (np.arange(1000) * 1e-3, 0.5, [Rows(0, 501), Rows(500, 1000)]),
        (np.arange(990) * 1e-3, 0.5, [Rows(0, 501)]),
        (np.arange(100) * 1e-3, 0.5, [Rows(0, 100)]),
        (np.arange(1001) * 1e-3, 0, [Rows(0, 1001)]),
        (np.array([0.0, 0.1, 0.2, 7.0, 7.1]), 0.5, [Rows(0, 3)]),
        (np.array([3.0, 4.0]), 0.5, []),
        (np.arange(5) * 0.7, 0.7, [Rows(i, i + 2) for i in range(4)]),
    ],
)
def test_cut(time, duration, expected):
    assert cut(time, duration) == expected


def test_twenty_four_seconds_are_forty_eight_windows():
    for rate in (100.0, 333.0, 1000.0):
        time = np.arange(int(24 * rate)) / rate
        assert len(cut(time, 0.5)) == 48


def test_windows_start_where_the_state_is_known():
    time = np.arange(21) * 0.1
    usable = np.ones(21, bool)
    usable[:3] = usable[10:16] = False
    assert cut(time, 1.0, usable) == [Rows(3, 11), Rows(16, 21)]
    assert cut(time, 1.0, ~usable) == [Rows(0, 11), Rows(10, 21)]
    assert cut(time, 1.0, np.zeros(21, bool)) == []


@pytest.mark.parametrize("duration", [-1.0, np.nan, np.inf])
def test_windows_of_no_duration(duration):
    with pytest.raises(InputError, match="a window lasts"):
        cut(np.arange(3.0), duration)


# -- between steps ---------------------------------------------------------------------------------


def test_places_between_nodes():
    place = Between(np.array([0.0, 0.25, 1.0 - 1e-9, 1.0, 1.5, 3.0]))
    np.testing.assert_array_equal(place.base, [0, 0, 0, 0, 1, 2])
    np.testing.assert_allclose(place.part, [0, 0.25, 1, 1, 0.5, 1])


def motion(model, t):
    """A smooth motion of `EVERYTHING` with its velocity."""
    qpos, qvel = np.zeros((len(t), model.nq)), np.zeros((len(t), model.nv))
    qpos[:, 0], qvel[:, 0] = np.sin(3 * t), 3 * np.cos(3 * t)
    qpos[:, 2], qvel[:, 2] = t**3, 3 * t**2
    axis = np.array([1.0, 2.0, 2.0]) / 3
    for q, v in ((5, 5), (9, 8)):
        qpos[:, q : q + 4] = quat.exp(np.sin(2 * t)[:, None] * axis)
        qvel[:, v : v + 3] = 2 * np.cos(2 * t)[:, None] * axis
    return qpos, qvel


def test_positions_between_steps_are_fourth_order():
    model = load_scene(EVERYTHING).model
    errors = []
    for step in (0.08, 0.04):
        part = np.full(1, 0.5)
        before, after, truth = (motion(model, np.array([0.3 + s * step])) for s in (0, 1, 0.5))
        found = positions(model, before, after, part, step)
        error = found - truth[0]
        errors.append((abs(error[0, 0]), np.abs(error[0, 5:]).max()))
        assert abs(error[0, 2]) < 1e-15  # a cubic is met exactly
    (a, b), (c, d) = errors
    assert a / c > 12
    assert b / d > 12
    assert max(c, d) < 2e-6


def test_nodes_are_met_exactly():
    model = load_scene(EVERYTHING).model
    before, after = (motion(model, np.array([s, s])) for s in (0.1, 0.3))
    found = positions(model, before, after, np.array([0.0, 1.0]), 0.2)
    np.testing.assert_array_equal(found[0], before[0][0])
    np.testing.assert_array_equal(found[1], after[0][0])
    np.testing.assert_array_equal(linear(before[0], after[0], np.array([0.0, 1.0]))[1], after[0][1])


# -- initial states --------------------------------------------------------------------------------


def test_velocities_where_the_integrator_has_them():
    """From positions alone, the states of a simulation come back to second order in its step."""
    for integrator, tolerance in (("Euler", 3e-4), ("implicitfast", 3e-4), ("RK4", 2e-5)):
        scene = load_scene(PENDULUM.replace("<option ", f"<option integrator='{integrator}' "))
        backend = orbisim.make_backend("mujoco", scene)
        state = backend.reset(1).replace(qpos=np.array([[1.5]]))
        trajectory = backend.rollout(state, np.zeros((1000, 1)))
        recording = capture(scene, trajectory, velocities=False)
        found = starts(bind(recording, scene))
        exact = trajectory.with_initial("qvel")[0]
        assert np.abs(found.qvel - exact)[10:-10].max() < tolerance
        assert found.notes == ("velocities of 'hinge' are estimated from the positions",)


def test_recorded_velocities_are_used_unless_smoothed_ones_are_wanted():
    scene = load_scene(PENDULUM)
    t = np.arange(500) * 2e-3
    qvel = 3 * np.cos(3 * t) + 0.2
    qvel[100] = np.nan
    bound = bind(Recording(t, {"qpos/hinge": np.sin(3 * t), "qvel/hinge": qvel}), scene)
    found = starts(bound)
    np.testing.assert_array_equal(np.delete(found.qvel[:, 0], 100), np.delete(qvel, 100))
    assert found.qvel[100] == pytest.approx(3 * np.cos(0.6), abs=0.02)
    assert found.notes == ()
    smoothed = starts(bound, "smoothed")
    assert np.abs(smoothed.qvel[:, 0] - 3 * np.cos(3 * t))[5:-5].max() < 0.02


ACTIVATED = """
<mujoco model="activated"><option timestep="0.002"/><worldbody>
  <body><joint name="a" axis="0 1 0" damping=".1"/><geom size=".1" pos="0 0 -.3"/></body>
  <body pos="1 0 0">
    <joint name="b" axis="0 1 0" damping=".1"/><geom size=".1" pos="0 0 -.3"/>
  </body>
</worldbody><actuator>
  <general name="slow" joint="a" dyntype="filterexact" dynprm=".05" gainprm="2"/>
  <intvelocity name="servo" joint="b" kp="20" actrange="-3 3"/>
  <motor name="late" joint="a" delay="0.02" nsample="15"/>
</actuator></mujoco>
"""


@pytest.fixture(scope="module")
def activated():
    scene = load_scene(ACTIVATED)
    backend = orbisim.make_backend("mujoco", scene)
    rng = np.random.default_rng(0)
    controls = 0.2 * np.repeat(rng.standard_normal((40, 3)), 10, axis=0)
    trajectory = backend.rollout(backend.reset(1), controls)
    return scene, trajectory


def test_activations_are_carried_along(activated):
    scene, trajectory = activated
    bound = bind(capture(scene, trajectory), scene)
    rows = np.array([0, 60, 61, 300])
    found = activations(bound, starts(bound), rows)
    exact = trajectory.with_initial("act")[0][rows]
    np.testing.assert_allclose(found[1:, 0], exact[1:, 0], atol=0.15 * np.exp(-0.12 / 0.05) + 1e-6)
    np.testing.assert_allclose(found[3], exact[3], atol=1e-6)
    np.testing.assert_allclose(found[:, 1], exact[:, 1], atol=1e-9)


def test_delay_buffers_hold_the_controls_before(activated):
    scene, trajectory = activated
    recording = capture(scene, trajectory)
    bound = bind(recording, scene)
    row = 200
    found = histories(bound, np.array([row]))[0]
    backend = orbisim.make_backend("mujoco", scene)
    start = backend.reset(1).replace(
        time=recording.time[[row]],
        qpos=bound.qpos[[row]],
        qvel=bound.qvel[[row]],
        act=trajectory.with_initial("act")[0][[row]],
    )
    again = backend.rollout(start.with_memory(history=found[None]), trajectory.control[0, row:])
    np.testing.assert_allclose(again.qpos[0], trajectory.qpos[0, row:], atol=1e-12)
    empty = backend.rollout(start, trajectory.control[0, row:])
    assert np.abs(empty.qpos[0] - trajectory.qpos[0, row:]).max() > 1e-4
