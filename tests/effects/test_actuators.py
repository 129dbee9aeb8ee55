"""Effects at actuators: edits against MJCF, and what regressions see against the force itself."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.errors import InputError

from .motion import Motion, added, found, offered


def test_lag_is_a_first_order_filter(scene: Scene) -> None:
    changed = add_effects(scene, [EffectInstance("actuator_lag", "m1", {"time_constant": 0.05})])
    engine = make_backend("mujoco", changed)
    state = engine.step(engine.reset(), [1.0, 0.0], 100)
    assert state.act[0, 0] == pytest.approx(1 - np.exp(-0.05 / 0.05), rel=1e-6)


def test_delay(scene: Scene) -> None:
    changed = add_effects(scene, [EffectInstance("actuator_delay", "m1", {"delay": 0.02})])
    engine = make_backend("mujoco", changed)
    engine.report = {"actuator_force"}
    state = engine.reset()
    forces = []
    for _ in range(60):
        state = engine.step(state, [1.0, 0.0])
        forces.append(state.memory["actuator_force"][0, 0])
    assert np.flatnonzero(np.abs(forces) > 1e-9)[0] == 40


def test_a_delay_between_timesteps_is_a_mean(scene: Scene) -> None:
    step = scene.model.opt.timestep
    changed = add_effects(scene, [EffectInstance("actuator_delay", "m1", {"delay": 4.25 * step})])
    data, forces = mujoco.MjData(changed.model), []
    for number in range(12):
        data.ctrl[0] = float(number >= 3)
        mujoco.mj_step(changed.model, data)
        forces.append(data.actuator_force[0] / changed.model.actuator_gainprm[0, 0])
    np.testing.assert_allclose(forces, [0.0] * 7 + [0.75] + [1.0] * 4, atol=1e-9)


def test_a_delay_of_whole_timesteps_is_the_same_at_all_times(scene: Scene) -> None:
    """Rounding of the time must not decide which of two controls is in force."""
    changed = add_effects(scene, [EffectInstance("actuator_delay", "m1", {"delay": 0.012})])
    steps = round(0.012 / changed.model.opt.timestep)
    data = mujoco.MjData(changed.model)
    controls = np.random.default_rng(1).uniform(-1, 1, 4000)
    forces = []
    for control in controls:
        data.ctrl[0] = control
        mujoco.mj_step(changed.model, data)
        forces.append(data.actuator_force[0])
    gain = changed.model.actuator_gainprm[0, 0]
    np.testing.assert_allclose(forces[steps:], gain * controls[:-steps], atol=1e-10)


SLED = """<mujoco><option timestep="{step}" integrator="RK4" gravity="0 0 0"/><worldbody><body>
  <joint name="rail" type="slide"/><geom size=".1" mass="1"/></body></worldbody>
  <actuator><motor name="m" joint="rail"/></actuator></mujoco>"""


@pytest.mark.parametrize("step", [0.002, 0.004, 0.008])
@pytest.mark.parametrize("delay", [0.0083, 0.0095, 0.0115, 0.013, 0.02])
def test_a_delay_is_as_long_through_the_stages_of_rk4(step: float, delay: float) -> None:
    """A mass of 1 kg under forces that are held for 8 ms is as fast as one that feels them so much
    later, but for changes that stages smear over two steps."""
    sled = load_scene(SLED.format(step=step))
    late = add_effects(sled, [EffectInstance("actuator_delay", "m", {"delay": delay})])
    controls, held = np.random.default_rng(0).choice([-1.0, 1.0], 100), round(0.008 / step)
    data, seen = mujoco.MjData(late.model), []
    for control in controls:
        data.ctrl[0] = control
        mujoco.mj_step(late.model, data, held)
        seen.append(data.qvel[0])
    impulse = np.concatenate([[0.0], np.cumsum(0.008 * controls)])
    ends = 0.008 * np.arange(1, len(controls) + 1) - delay
    expected = np.interp(ends, 0.008 * np.arange(len(impulse)), impulse)
    np.testing.assert_allclose(seen, expected, atol=0.15 * step)  # of half a step, 0.5


def test_a_delay_is_no_shorter_in_shorter_steps() -> None:
    """As a log is followed that is sampled a little more slowly than the scene is stepped."""
    sled = load_scene(SLED.format(step=0.01).replace("RK4", "Euler"))
    late = add_effects(sled, [EffectInstance("actuator_delay", "m", {"delay": 0.1})])
    late.model.opt.timestep = step = 0.0051
    data, forces = mujoco.MjData(late.model), []
    for _ in range(40):
        data.ctrl[0] = 1.0
        mujoco.mj_step(late.model, data)
        forces.append(data.actuator_force[0])
    assert np.sum(1.0 - np.array(forces)) * step == pytest.approx(0.1, abs=step)


FITTED = {"torque_gain": [0.5], "torque_bias": [0.3], "torque_saturation": [1.0], "deadband": [1.0]}


@pytest.mark.parametrize("target", ["m1", "p2"])
@pytest.mark.parametrize("name", FITTED)
def test_regressions_see_the_force(scene: Scene, motion: Motion, name: str, target: str) -> None:
    candidates = find(name).screen(motion, target)
    assert candidates
    for candidate in candidates:
        expected = added(scene, motion, found(candidate, FITTED[name]))
        np.testing.assert_allclose(offered(candidate, FITTED[name]), expected, atol=1e-9)
        assert np.abs(expected).max() > 1e-3


def test_a_gain_is_what_it_is_times(motion: Motion) -> None:
    (candidate,) = find("torque_gain").screen(motion, "m1")
    assert candidate.solve(np.array([-0.25])) == {"gain": 0.75}


def test_late_controls_are_seen_as_the_motion_has_them(motion: Motion) -> None:
    lags = find("actuator_lag").screen(motion, "p2")
    delays = find("actuator_delay").screen(motion, "p2")
    for lag, delay in zip(lags, delays, strict=True):
        tau, late = lag.solve(np.ones(1)), delay.solve(np.ones(1))
        assert tau is not None
        assert late is not None
        assert lag.fixed
        assert delay.fixed
        gain, u = motion.model.actuator_gainprm[1, 0], motion.ctrl[:, 1]
        share = 1 / (1 + tau["time_constant"]) - 1
        np.testing.assert_allclose(lag.columns[0].values[:, 1], gain * u * share, atol=1e-12)
        expected = np.full(len(u), -gain * late["delay"])
        np.testing.assert_allclose(delay.columns[0].values[:, 1], expected, atol=1e-12)


def test_a_limit_is_tried_below_commands_that_are_all_at_their_ends(motion: Motion) -> None:
    force = np.tile([[-2.0], [2.0]], (6, motion.model.nu))
    switched = dataclasses.replace(motion)
    object.__setattr__(switched, "actuator_force", force)
    tried = [c.solve(np.ones(1)) for c in find("torque_saturation").screen(switched, "m1")]
    assert [one["limit"] for one in tried if one] == [0.5, 1.0, 1.5, 2.0]


def test_a_limit_only_tightens(scene: Scene) -> None:
    limits = []
    for limit in (3.0, 1.0, 2.0):
        scene = add_effects(scene, [EffectInstance("torque_saturation", "m1", {"limit": limit})])
        limits.append(scene.model.actuator_forcerange[0].tolist())
    assert limits == [[-3, 3], [-1, 1], [-1, 1]]


def test_actuators_that_are_not_affine_have_none_of_it() -> None:
    model = load_scene(
        """<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
        <actuator><motor name="plain" joint="j"/>
        <general name="slow" joint="j" dyntype="filter" dynprm="1"/>
        <muscle name="muscle" joint="j" lengthrange="0 1"/></actuator></mujoco>"""
    ).model
    assert find("torque_gain").targets(model) == ("plain", "slow")
    assert find("actuator_lag").targets(model) == ("plain",)


def test_a_declared_delay_is_the_only_one(scene: Scene) -> None:
    late = add_effects(scene, [EffectInstance("actuator_delay", "m1", {"delay": 0.02})])
    assert find("actuator_delay").targets(late.model) == ("p2",)


def test_dead_bands_of_no_kind_are_refused(scene: Scene) -> None:
    one = EffectInstance("deadband", "m1", {"width": 0.1}, {"kind": "soft"})
    with pytest.raises(InputError, match="kind is shift or gate; got 'soft'"):
        find("deadband").hook(scene.model, one)
