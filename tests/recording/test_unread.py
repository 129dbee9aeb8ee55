"""Joints that effects added start windows where the recording so far says they are."""

from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance, add_effects
from orbisim.host.engine_log import engine_warnings, ignore
from orbisim.recording import Recording, bind
from orbisim.recording.initial import starts
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"
NOISE = 1e-4
HIDDEN = [
    EffectInstance("backlash", "elbow", {"width": 0.05}),
    EffectInstance("backlash", "shoulder", {"width": 0.03}),
    EffectInstance("joint_flexibility", "elbow", {"stiffness": 5.0, "damping": 0.02}),
    EffectInstance("joint_flexibility", "shoulder", {"stiffness": 40.0, "damping": 0.2}),
]


@pytest.fixture(scope="module")
def arm() -> orbisim.Scene:
    return orbisim.load_scene(ARM)


def _run(arm: orbisim.Scene, *effects: EffectInstance) -> Recording:
    (run,) = inject_effect(arm, effects, duration=2.5, episodes=1, noise=NOISE, seed=3)
    return run


@pytest.mark.parametrize("effect", HIDDEN, ids=lambda e: f"{e.effect}-{e.target}")
def test_the_true_scene_predicts_to_within_the_noise(
    arm: orbisim.Scene, effect: EffectInstance
) -> None:
    run, true = _run(arm, effect), add_effects(arm, [effect])
    found = orbisim.replay(true, run)
    assert orbisim.replay(arm, run).rms > 30 * NOISE
    assert np.median([w.rms for w in found.windows]) < 3 * NOISE
    assert found.rms < 8 * NOISE
    assert any("carried along" in note for note in found.notes)


def test_a_start_in_the_middle_of_a_motion_is_found_after_a_while(arm: orbisim.Scene) -> None:
    effect = HIDDEN[3]
    run = _run(arm, effect).rows(slice(60, None))
    found = orbisim.replay(add_effects(arm, [effect]), run)
    assert max(w.rms for w in found.windows[1:]) < 5 * NOISE


def test_an_added_lag_is_carried_too(arm: orbisim.Scene) -> None:
    effects = [HIDDEN[2], EffectInstance("actuator_lag", "elbow", {"time_constant": 0.05})]
    found = orbisim.replay(add_effects(arm, effects), _run(arm, *effects))
    assert found.rms < 8 * NOISE


def test_a_late_motor_is_no_obstacle(arm: orbisim.Scene) -> None:
    """MuJoCo has no derivatives of a scene with delay buffers."""
    effects = [HIDDEN[2], EffectInstance("actuator_delay", "elbow", {"delay": 0.02})]
    found = orbisim.replay(add_effects(arm, effects), _run(arm, *effects))
    assert found.rms < 8 * NOISE


def test_nothing_after_a_sample_tells_the_state_there(arm: orbisim.Scene) -> None:
    effect, border = HIDDEN[0], 120
    run, true = _run(arm, effect), add_effects(arm, [effect])
    whole = starts(bind(run, true))
    cut = starts(bind(run.rows(slice(0, border)), true))
    hidden = true.model.joint("elbow_backlash")
    np.testing.assert_allclose(
        cut.qpos[:, hidden.qposadr], whole.qpos[:border, hidden.qposadr], atol=2e-4
    )


def test_a_recorded_hidden_joint_stays_as_it_was_recorded(arm: orbisim.Scene) -> None:
    effect = HIDDEN[0]
    run, true = _run(arm, effect), add_effects(arm, [effect])
    still = np.zeros(len(run))
    shown = {"qpos/elbow_backlash": still + 0.01, "qvel/elbow_backlash": still}
    states = starts(bind(run.replace(signals={**run.signals, **shown}), true))
    column = int(true.model.joint("elbow_backlash").qposadr[0])
    np.testing.assert_array_equal(states.qpos[:, column], 0.01)


@pytest.mark.parametrize("damping", [-1.0, -10.0])
def test_a_scene_that_gains_energy_is_scored_all_the_same(
    arm: orbisim.Scene, damping: float
) -> None:
    """What is known of the state that is not read grows without limit then."""
    unstable = EffectInstance("viscous_damping", "shoulder", {"coefficient": damping})
    run = _run(arm, HIDDEN[2])
    with engine_warnings(ignore):
        found = orbisim.replay(add_effects(arm, [HIDDEN[2], unstable]), run)
    assert found.rms > 1000 * NOISE
