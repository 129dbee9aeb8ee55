"""Effects of the measurement: where they are, and what regressions see of them."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Scene, load_scene
from orbisim.effects import EffectInstance, find
from orbisim.effects.sensors import axis_of
from orbisim.errors import InputError, UnknownNameError

from .motion import Motion, found, offered

NV = 8


def test_a_bias_shifts_positions(motion: Motion) -> None:
    (candidate,) = find("sensor_bias").screen(motion, "elbow")
    expected = np.zeros((len(motion.data), 2 * NV))
    expected[:, 1] = 0.3
    np.testing.assert_array_equal(offered(candidate, [0.3]), expected)
    assert found(candidate, [0.3]).values == {"offset": 0.3}


def test_a_scale_grows_with_what_is_measured(motion: Motion) -> None:
    (candidate,) = find("sensor_scale").screen(motion, "elbow")
    change = offered(candidate, [0.02])
    np.testing.assert_allclose(change[:, 1], 0.02 * motion.qpos[:, 1])
    np.testing.assert_allclose(change[:, NV + 1], 0.02 * motion.qvel[:, 1])
    assert np.count_nonzero(change.any(axis=0)) == 2
    assert found(candidate, [0.02]).values == {"factor": 1.02}
    (free,) = find("sensor_scale").screen(motion, "free")
    np.testing.assert_allclose(offered(free, [1.0])[:, 2:5], motion.qpos[:, 2:5])


def test_a_delay_is_the_rate_of_change(motion: Motion) -> None:
    (candidate,) = find("sensor_delay").screen(motion, "elbow")
    late = offered(candidate, [0.01])
    np.testing.assert_allclose(late[:, 1], -0.01 * motion.qvel[:, 1])
    np.testing.assert_allclose(late[:, NV + 1], -0.01 * motion.qacc[:, 1])


def test_a_fast_clock_makes_intervals_look_longer(motion: Motion) -> None:
    (candidate,) = find("clock_skew").screen(motion, "recording")
    half = len(motion.data) // 2
    step = motion.time[half:] - motion.time[:half]
    change = offered(candidate, [0.01])
    np.testing.assert_allclose(change[:, :NV], -0.01 * step[:, None] * motion.qvel[:half])
    np.testing.assert_allclose(change[:, NV:], -0.01 * step[:, None] * motion.qacc[:half])
    assert found(candidate, [0.01]).values == {"factor": 1.01}


def test_targets(scene: Scene) -> None:
    assert find("sensor_bias").targets(scene.model) == ("shoulder", "elbow", "s1")
    assert find("sensor_scale").targets(scene.model) == ("shoulder", "elbow", "s1", "free")
    assert find("clock_skew").targets(scene.model) == ("recording",)


def test_units_are_those_of_what_is_measured() -> None:
    model = load_scene(
        """<mujoco><worldbody><body><joint name="slide" type="slide"/><geom size=".1"/>
        <site name="s"/></body></worldbody><sensor><gyro name="gyro" site="s"/></sensor></mujoco>"""
    ).model
    units = [find("sensor_bias").parameters(model, n)[0].unit for n in ("slide", "gyro")]
    assert units == ["m", "rad/s"]


def test_axes() -> None:
    def one(**options: str) -> EffectInstance:
        return EffectInstance("sensor_bias", "gyro", {"offset": 1.0}, options)

    assert axis_of(one(), 3) is None
    assert axis_of(one(axis="z"), 3) == 2
    with pytest.raises(InputError, match="axis is 'w'; one of x, y, z"):
        axis_of(one(axis="w"), 3)
    with pytest.raises(InputError, match="one component only"):
        axis_of(one(axis="x"), 1)


def test_unknown_targets_and_values_out_of_bounds(scene: Scene) -> None:
    effect = find("sensor_delay")
    with pytest.raises(UnknownNameError, match="did you mean 'elbow'"):
        effect.check(scene.model, EffectInstance("sensor_delay", "elbo", {"delay": 0.1}))
    with pytest.raises(InputError, match="within -1 to 1 s"):
        effect.check(scene.model, EffectInstance("sensor_delay", "elbow", {"delay": 2.0}))


def test_a_sensor_that_is_early_is_another_one_that_is_late(scene: Scene) -> None:
    effect = find("sensor_delay")
    first, *others = effect.targets(scene.model)
    early = EffectInstance("sensor_delay", first, {"delay": -0.003})
    late = [EffectInstance("sensor_delay", one, {"delay": 0.003}) for one in others]
    assert others and effect.equivalents(scene.model, early) == late
    assert effect.equivalents(scene.model, late[0]) == []
