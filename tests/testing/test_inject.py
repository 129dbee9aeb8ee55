"""Injected effects show where they should, and recordings look like a rig's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mjcf_assets
from orbisim import Recording, Scene, load_scene, replay
from orbisim.effects import EffectInstance
from orbisim.errors import DivergedError, InputError, UnknownNameError
from orbisim.recording import bind
from orbisim.testing import inject_effect

ASSETS = Path(mjcf_assets.__file__).parent


@pytest.fixture(scope="module")
def arm() -> Scene:
    return load_scene(ASSETS / "arm2" / "scene.xml")


def effect(name: str, target: str, options: dict[str, str] | None = None, **values: float):
    return EffectInstance(name, target, values, options or {})


def joint_errors(scene: Scene, recordings: list[Recording]) -> dict[str, float]:
    found = replay(scene, recordings, window=0.02).signals
    return {n.partition("/")[2]: e.rms for n, e in found.items() if n.startswith("qvel/")}


# -- recordings as a rig gives them ----------------------------------------------------------------


def test_without_effects_the_declared_scene_explains_everything(arm: Scene) -> None:
    recordings = inject_effect(arm, [], noise=0.0, episodes=2, duration=2.0)
    assert replay(arm, recordings).rms < 1e-9


def test_noise_has_the_asked_size(arm: Scene) -> None:
    clean = inject_effect(arm, [], noise=0.0, episodes=1)[0]
    noisy = inject_effect(arm, [], noise=1e-3, velocity_noise=0.02, episodes=1)[0]
    assert np.std(noisy["qpos/elbow"] - clean["qpos/elbow"]) == pytest.approx(1e-3, rel=0.1)
    assert np.std(noisy["qvel/elbow"] - clean["qvel/elbow"]) == pytest.approx(0.02, rel=0.1)
    assert np.array_equal(noisy["ctrl/elbow"], clean["ctrl/elbow"])


def test_rotations_keep_unit_norm_and_turn_by_the_noise() -> None:
    ball = load_scene(ASSETS / "bouncing_ball" / "scene.xml")
    clean = inject_effect(ball, [], noise=0.0, episodes=1)[0]["qpos/ball"]
    noisy = inject_effect(ball, [], noise=1e-3, episodes=1)[0]["qpos/ball"]
    assert np.allclose(np.linalg.norm(noisy[:, 3:], axis=1), 1.0)
    angle = 2 * np.arccos(np.clip(np.abs((clean[:, 3:] * noisy[:, 3:]).sum(1)), 0, 1))
    assert np.sqrt(np.mean(angle**2) / 3) == pytest.approx(1e-3, rel=0.15)


def test_the_seed_decides_everything(arm: Scene) -> None:
    one, two, other = (inject_effect(arm, [], episodes=2, duration=1.0, seed=s) for s in (3, 3, 4))
    assert one == two
    assert one != other


def test_velocities_may_be_missing(arm: Scene) -> None:
    recording = inject_effect(arm, [], velocities=False, episodes=1, duration=1.0)[0]
    assert sorted(recording.signals) == [
        "ctrl/elbow",
        "ctrl/shoulder",
        "qpos/elbow",
        "qpos/shoulder",
    ]


def test_controls_and_starts_may_be_given(arm: Scene) -> None:
    controls = np.tile([0.5, -0.1], (50, 1))
    starts = np.array([0.2, 0.1, 0.0, 0.3])
    recording = inject_effect(
        arm, [], controls=controls, starts=starts, episodes=1, noise=0.0, duration=0.5
    )[0]
    assert len(recording) == 51
    assert recording["qpos/shoulder"][0] == 0.2
    assert recording["qvel/elbow"][0] == 0.3
    assert (recording["ctrl/elbow"] == -0.1).all()


def test_a_controller_may_be_given(arm: Scene) -> None:
    recording = inject_effect(
        arm, [], controls=lambda t, q, v: -0.1 * v, episodes=2, noise=0.0, duration=0.5
    )[1]
    assert np.allclose(recording["ctrl/elbow"][:-1], -0.1 * recording["qvel/elbow"][:-1])


@pytest.mark.parametrize(
    "hidden",
    [
        effect("backlash", "elbow", width=0.05),
        effect("joint_flexibility", "elbow", stiffness=30.0, damping=0.05),
        effect("actuator_lag", "elbow", time_constant=0.05),
        effect("actuator_delay", "elbow", delay=0.03),
    ],
    ids=lambda e: e.effect,
)
def test_hidden_states_are_not_recorded(arm: Scene, hidden: EffectInstance) -> None:
    plain = inject_effect(arm, [], episodes=1, duration=2.0, noise=0.0)[0]
    found = inject_effect(arm, hidden, episodes=1, duration=2.0, noise=0.0)[0]
    assert found.signals.keys() == plain.signals.keys()
    assert found["qpos/elbow"][0] == plain["qpos/elbow"][0]
    assert np.abs(found["qpos/elbow"] - plain["qpos/elbow"]).max() > 1e-3


def test_a_servo_with_hidden_states_starts_at_rest() -> None:
    servo = load_scene(ASSETS / "servo_pendulum" / "scene.xml")
    start = np.array([1.0, 0.0])
    hold = np.full((30, 1), 1.0 + 0.55 * 9.81 * 0.15 * np.sin(1.0) / 8)
    for hidden in (
        effect("actuator_delay", "servo", delay=0.05),
        effect("actuator_lag", "servo", time_constant=0.1),
        effect("joint_flexibility", "servo", stiffness=60.0, damping=0.1),
    ):
        found = inject_effect(
            servo, hidden, controls=hold, starts=start, episodes=1, duration=0.3, noise=0.0
        )[0]
        assert np.ptp(found["qpos/servo"]) < 0.01, hidden


# -- effects show where they are -------------------------------------------------------------------

AT_ELBOW = [
    effect("coulomb_friction", "elbow", torque=0.1),
    effect("viscous_damping", "elbow", coefficient=0.1),
    effect("quadratic_damping", "elbow", coefficient=0.05),
    effect("stribeck_friction", "elbow", coulomb=0.05, static=0.12, velocity=0.3),
    effect("load_dependent_friction", "elbow", coefficient=0.3),
    effect("joint_spring", "elbow", stiffness=1.0, rest_position=0.3),
    effect("armature", "elbow", inertia=0.02),
    effect("cogging", "elbow", amplitude=0.1, periods=12.0, phase=0.5),
    effect("periodic_disturbance", "elbow", amplitude=0.1, frequency=2.0, phase=0.0),
    effect("torque_gain", "elbow", gain=0.7),
    effect("torque_bias", "elbow", offset=0.1),
    effect("torque_saturation", "elbow", limit=0.2),
    effect("deadband", "elbow", width=0.4),
]


@pytest.mark.parametrize("one", AT_ELBOW, ids=lambda e: e.effect)
def test_an_effect_at_the_elbow_shows_at_the_elbow(arm: Scene, one: EffectInstance) -> None:
    recordings = inject_effect(arm, one, noise=0.0, episodes=1, duration=3.0)
    errors = joint_errors(arm, recordings)
    assert errors["elbow"] > 1e-3
    assert errors["elbow"] > errors["shoulder"]


@pytest.mark.parametrize(
    "one",
    [
        effect("sensor_bias", "elbow", offset=0.02),
        effect("sensor_scale", "elbow", factor=1.02),
        effect("sensor_delay", "elbow", delay=0.013),
    ],
    ids=lambda e: e.effect,
)
def test_measurement_effects_change_the_sensor_only(arm: Scene, one: EffectInstance) -> None:
    plain = inject_effect(arm, [], noise=0.0, episodes=1, duration=2.0)[0]
    found = inject_effect(arm, one, noise=0.0, episodes=1, duration=2.0)[0]
    shared = np.searchsorted(plain.time, found.time[found.time < 2.0] - 1e-9)
    some = found.rows(slice(0, len(shared)))
    assert np.array_equal(some["qpos/shoulder"], plain["qpos/shoulder"][shared])
    assert np.array_equal(some["ctrl/elbow"], plain["ctrl/elbow"][shared])
    truth = plain["qpos/elbow"][shared]
    if one.effect == "sensor_bias":
        assert np.allclose(some["qpos/elbow"], truth + 0.02, atol=1e-12)
    elif one.effect == "sensor_scale":
        assert np.allclose(some["qpos/elbow"], 1.02 * truth, atol=1e-12)
    else:
        late = np.interp(some.time - 0.013, plain.time, plain["qpos/elbow"])
        assert np.allclose(some["qpos/elbow"], late, atol=3e-3)


def test_a_fast_clock_stretches_time(arm: Scene) -> None:
    clock = effect("clock_skew", "recording", factor=1.02)
    found = inject_effect(arm, clock, noise=0.0, episodes=1, duration=2.0)[0]
    assert found.time[-1] == pytest.approx(2.04)
    assert np.allclose(np.diff(found.time), 0.0102)


# -- errors ----------------------------------------------------------------------------------------


def test_wrong_input_is_named(arm: Scene) -> None:
    with pytest.raises(UnknownNameError, match="coulomb_friction"):
        inject_effect(arm, effect("coulomb", "elbow", torque=1.0))
    with pytest.raises(UnknownNameError, match="elbow"):
        inject_effect(arm, effect("coulomb_friction", "elbo", torque=1.0))
    with pytest.raises(InputError, match="100"):
        inject_effect(arm, [], rate=97.0)
    with pytest.raises(InputError, match="controls"):
        inject_effect(arm, [], controls=np.zeros((10, 3)))
    with pytest.raises(InputError, match="starts"):
        inject_effect(arm, [], starts=np.zeros(3))


def test_divergence_names_the_effect(arm: Scene) -> None:
    with pytest.raises(DivergedError, match="viscous_damping"):
        inject_effect(arm, effect("viscous_damping", "elbow", coefficient=-50.0))


# -- every scene of the blind trials moves ---------------------------------------------------------

SCENES = (
    "arm2",
    "arm6",
    "cart_pole",
    "servo_pendulum",
    "puck",
    "bouncing_ball",
    "drone",
    "gripper_push",
    "leg",
)


@pytest.mark.parametrize("name", SCENES)
def test_excitation_moves_everything_and_stays_in_range(name: str) -> None:
    scene = load_scene(ASSETS / name / "scene.xml")
    recordings = inject_effect(scene, [], noise=0.0, episodes=2)
    for recording in recordings:
        for signal, values in recording.signals.items():
            if signal.startswith("qpos"):
                assert np.ptp(values.reshape(len(values), -1), axis=0).max() > 0.05, signal
        bound = bind(recording, scene)
        for u in range(scene.model.nu):
            low, high = scene.model.actuator_ctrlrange[u]
            assert (bound.ctrl[:, u] >= low - 1e-9).all()
            assert (bound.ctrl[:, u] <= high + 1e-9).all()
