"""How true states appear in a recording, against what recordings are distorted by."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.effects.measured import distort
from orbisim.effects.measurement import TRUE, Measurement, _Between, measurement_of
from orbisim.recording import Recording

SCENE = """
<mujoco><worldbody><body>
  <joint name="a" type="hinge"/><geom size="0.1"/>
</body></worldbody></mujoco>
"""
TIME = np.linspace(0, 2, 201)


@pytest.mark.parametrize(
    "effects",
    [
        [EffectInstance("sensor_bias", "a", {"offset": 0.1})],
        [EffectInstance("sensor_scale", "a", {"factor": 1.2})],
        [EffectInstance("sensor_delay", "a", {"delay": 0.035})],
        [
            EffectInstance("sensor_bias", "a", {"offset": -0.2}),
            EffectInstance("sensor_scale", "a", {"factor": 0.9}),
            EffectInstance("sensor_delay", "a", {"delay": 0.02}),
        ],
    ],
    ids=["bias", "scale", "delay", "all"],
)
def test_it_is_what_a_distorted_recording_has(effects: list[EffectInstance]) -> None:
    scene = orbisim.load_scene(SCENE)
    truth = Recording(TIME, {"qpos/a": np.sin(3 * TIME), "qvel/a": 3 * np.cos(3 * TIME)})
    states = np.stack([truth["qpos/a"], truth["qvel/a"]], axis=1)[None]
    seen = measurement_of(scene.model, effects).of(np.zeros_like(states), states, TIME[None])[0]
    expected = distort(truth, effects, scene)
    rows = np.searchsorted(TIME, expected.time - 1e-9)
    np.testing.assert_allclose(seen[rows, 0], expected["qpos/a"].ravel(), atol=1e-5)
    np.testing.assert_allclose(seen[rows, 1], expected["qvel/a"].ravel(), atol=2e-3)


def test_a_clock_is_read_apart() -> None:
    scene = orbisim.load_scene(SCENE)
    fast = measurement_of(scene.model, [EffectInstance("clock_skew", "recording", {"factor": 1.1})])
    assert fast.clock == 1.1 and not fast
    assert not TRUE and TRUE.clock == 1.0
    friction = EffectInstance("coulomb_friction", "a", {"torque": 1.0})
    assert not measurement_of(scene.model, [friction])


def test_velocities_between_samples_are_slopes_of_the_motion() -> None:
    """Exactly so of a cubic, which linear interpolation misses by an eighth of its jerk times the
    square of an interval."""
    time = np.linspace(0.0, 0.5, 6)
    truth = np.stack([time**3, 3 * time**2], axis=-1)[None]
    late = Measurement(bias=np.zeros(2), scale=np.ones(2), delay=np.full(2, 0.03))
    read = late.of(np.zeros_like(truth), truth, time[None])[0, 1:]
    assert read[:, 0] == pytest.approx((time[1:] - 0.03) ** 3)
    assert read[:, 1] == pytest.approx(3 * (time[1:] - 0.03) ** 2)


def test_a_late_velocity_follows_what_samples_resolve_and_does_not_swing() -> None:
    """Of a parabola it is exact between samples; of one that changes at once, near a line."""
    t = np.arange(8) * 0.1
    at = t[2:6] + 0.05
    smooth = np.stack([t**3, 3 * t**2], axis=1)
    found = _Between(t[None], at[None]).of(smooth[None], 1)[0]
    np.testing.assert_allclose(found, 3 * at**2, atol=1e-12)
    speed = np.where(np.arange(8) < 4, 0.0, 1.0)  # and a leap of the position in between
    jump = np.stack([np.where(np.arange(8) < 4, 0.0, 0.5), speed], axis=1)
    found = _Between(t[None], t[None, 3:4] + 0.05).of(jump[None], 1)[0]
    assert abs(found[0] - 0.5) <= 1 / 8 + 1e-12  # the cubic's own slope there is 7.25


PENDULUM = """
<mujoco><option timestep="0.004"/><worldbody><body>
  <joint name="a" type="hinge" axis="1 0 0"/><geom size="0.1" pos="0 0.2 0"/>
</body></worldbody></mujoco>
"""


@pytest.mark.parametrize("integrator", ["EULER", "IMPLICITFAST", "RK4"])
def test_a_late_velocity_of_a_simulated_motion_is_that_of_when_it_was_read(integrator: str) -> None:
    """Semi-implicit integrators advance positions with the new velocity, which belongs half a step
    before. Slopes of the positions are half a step late beside it: 0.06 rad/s of this pendulum,
    many times the noise of a sensor."""
    model = orbisim.load_scene(PENDULUM).model
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    step, every, late = model.opt.timestep, 5, 2
    data, states = mujoco.MjData(model), np.empty((251, 2))
    for row in states:
        row[:] = data.qpos[0], data.qvel[0]
        mujoco.mj_step(model, data)
    time, truth = step * np.arange(0, 251, every), states[None, ::every]
    measured = Measurement(bias=np.zeros(2), scale=np.ones(2), delay=np.full(2, late * step))
    before = 0.0 if integrator == "RK4" else step / 2
    read = measured.of(np.zeros_like(truth), truth, time[None], before)[0, 1:]
    expected = states[every - late :: every][: len(read)]
    assert read[:, 0] == pytest.approx(expected[:, 0], abs=5e-5)
    assert read[:, 1] == pytest.approx(expected[:, 1], abs=3e-3)
    if before:
        blind = measured.of(np.zeros_like(truth), truth, time[None])[0, 1:, 1]
        assert np.abs(blind - expected[:, 1]).max() > 0.05
