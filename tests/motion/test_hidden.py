"""Where declared coordinates stand in a variant, and states that no sensor shows."""

from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance, add_effects
from orbisim.motion.hidden import Layout, carried_along, first_order
from orbisim.motion.samples import prepare
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


def test_joints_that_effects_add_are_hidden() -> None:
    arm = orbisim.load_scene(ARM)
    play = EffectInstance("backlash", "shoulder", {"width": 0.02})
    variant = add_effects(arm, [play])
    place = Layout(arm.model, variant.model)
    names = [variant.model.joint(int(variant.model.dof_jntid[v])).name for v in place.v]
    assert names == ["shoulder", "elbow"]
    assert len(place.hidden_q) == len(place.hidden_v) == variant.model.nv - arm.model.nv == 1
    assert not {*place.v} & {*place.hidden_v}


def test_a_held_signal_after_a_filter() -> None:
    time = np.linspace(0, 1, 101)
    step = np.where(time < 0.2, 0.0, 1.0)
    found = first_order(time, step, 0.1)
    after = time >= 0.2
    np.testing.assert_allclose(found[after], 1 - np.exp(-(time[after] - 0.2) / 0.1), atol=1e-9)
    assert not found[~after].any()


def test_an_added_lag_follows_from_the_controls() -> None:
    arm = orbisim.load_scene(ARM)
    (run,) = inject_effect(arm, [], duration=1.0, episodes=1, noise=0.0, seed=1)
    one = prepare(run, arm)
    actuator = arm.model.actuator(0).name
    variant = add_effects(arm, [EffectInstance("actuator_lag", actuator, {"time_constant": 0.05})])
    act, history = carried_along(one, arm.model, variant.model, np.arange(10, 20))
    assert act.shape == (10, 1) and history.shape == (10, 0)
    expected = first_order(one.time, one.ctrl[:, 0], 0.05)[10:20]
    assert act[:, 0] == pytest.approx(expected)
