"""What effects of the measurement do to a recording, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mjcf_assets
from orbisim import Recording, Scene, load_scene
from orbisim.effects import EffectInstance
from orbisim.effects.measured import correct, distort, longest_delay
from orbisim.errors import InputError
from orbisim.testing import inject_effect

ASSETS = Path(mjcf_assets.__file__).parent


@pytest.fixture(scope="module")
def arm() -> Scene:
    return load_scene(ASSETS / "arm2" / "scene.xml")


def effect(name: str, target: str, options: dict[str, str] | None = None, **values: float):
    return EffectInstance(name, target, values, options or {})


DISTORTIONS = [
    effect("sensor_bias", "elbow", offset=0.03),
    effect("sensor_scale", "shoulder", factor=1.04),
    effect("sensor_delay", "elbow", delay=0.0234),
    effect("sensor_delay", "shoulder", delay=-0.011),
    effect("clock_skew", "recording", factor=0.97),
]


@pytest.mark.parametrize("velocities", [True, False])
def test_correct_undoes_distort(arm: Scene, velocities: bool) -> None:
    clean = inject_effect(arm, [], noise=0.0, episodes=1, velocities=velocities, rate=500.0)[0]
    back = correct(distort(clean, DISTORTIONS, arm), DISTORTIONS, arm)
    rows = np.searchsorted(clean.time, back.time - 1e-9)
    assert len(rows) > len(clean) - 40
    assert np.allclose(back.time, clean.time[rows], atol=1e-9)
    for name in clean.signals:
        tolerance = 1e-5 if name.startswith("qpos") else 1e-2
        assert np.allclose(back[name], clean[name][rows], atol=tolerance), name


def test_a_delay_of_whole_samples_is_exact(arm: Scene) -> None:
    clean = inject_effect(arm, [], noise=0.0, episodes=1, duration=1.0)[0]
    late = distort(clean, [effect("sensor_delay", "elbow", delay=0.03)], arm)
    assert np.allclose(late["qpos/elbow"], clean["qpos/elbow"][:-3], atol=1e-12)
    assert np.array_equal(late["qpos/shoulder"], clean["qpos/shoulder"][3:])


def test_a_length_scale_acts_on_a_free_body() -> None:
    ball = load_scene(ASSETS / "bouncing_ball" / "scene.xml")
    clean = inject_effect(ball, [], noise=0.0, episodes=1)[0]
    scaled = distort(clean, [effect("sensor_scale", "ball", factor=0.98)], ball)
    assert np.allclose(scaled["qpos/ball"][:, :3], 0.98 * clean["qpos/ball"][:, :3])
    assert np.array_equal(scaled["qpos/ball"][:, 3:], clean["qpos/ball"][:, 3:])
    assert np.array_equal(scaled["qvel/ball"][:, 3:], clean["qvel/ball"][:, 3:])


def sine(names: tuple[str, ...] = ("qpos/elbow", "qvel/elbow")) -> Recording:
    time = np.linspace(0, 1, 201)
    signals = {"qpos/elbow": np.sin(5 * time), "qvel/elbow": 5 * np.cos(5 * time)}
    return Recording(time, {name: signals[name] for name in names})


def test_a_body_that_is_known_by_its_place_is_scaled_there() -> None:
    ball = load_scene(ASSETS / "bouncing_ball" / "scene.xml")
    place = np.arange(12.0).reshape(4, 3)
    seen = Recording(np.arange(4.0), {"xpos/ball": place, "xquat/ball": np.eye(4)})
    scale = [effect("sensor_scale", "ball", factor=0.5)]
    assert np.allclose(distort(seen, scale, ball)["xpos/ball"], 0.5 * place)
    assert np.allclose(correct(distort(seen, scale, ball), scale, ball)["xpos/ball"], place)


def test_each_distortion_is_its_formula(arm: Scene) -> None:
    """s x(t - d) + b, and then the clock."""
    every = [
        effect("sensor_bias", "elbow", offset=0.2),
        effect("sensor_scale", "elbow", factor=1.5),
        effect("sensor_delay", "elbow", delay=0.0423),
        effect("clock_skew", "recording", factor=1.25),
    ]
    late = distort(sine(), every, arm)
    time = late.time / 1.25
    expected = 1.5 * np.sin(5 * (time - 0.0423)) + 0.2
    np.testing.assert_allclose(late["qpos/elbow"], expected, atol=1e-8)
    speed = 1.5 * 5 * np.cos(5 * (time - 0.0423))  # an offset does not change it
    np.testing.assert_allclose(late["qvel/elbow"], speed, atol=1e-5)
    assert time[0] == pytest.approx(0.045)  # the first sample whose past is known
    assert longest_delay(every) == 0.0423


def test_positions_without_velocities_are_shifted_too(arm: Scene) -> None:
    early = distort(sine(("qpos/elbow",)), [effect("sensor_delay", "elbow", delay=-0.01)], arm)
    np.testing.assert_allclose(early["qpos/elbow"], np.sin(5 * (early.time + 0.01)), atol=1e-6)


def test_other_effects_change_no_recording(arm: Scene) -> None:
    found = distort(sine(), [effect("coulomb_friction", "elbow", torque=1.0)], arm)
    np.testing.assert_array_equal(found["qpos/elbow"], sine()["qpos/elbow"])
    assert longest_delay([]) == 0.0


def test_what_cannot_be_distorted_is_said(arm: Scene) -> None:
    with pytest.raises(InputError, match="'shoulder' is not recorded"):
        distort(sine(), [effect("sensor_bias", "shoulder", offset=0.1)], arm)
    short = sine().rows(slice(0, 5))
    with pytest.raises(InputError, match="shorter than the delay"):
        distort(short, [effect("sensor_delay", "elbow", delay=0.5)], arm)


VECTOR = """
<mujoco><worldbody><body><joint name="j"/><geom size=".1"/><site name="s"/></body></worldbody>
<sensor><gyro name="gyro" site="s"/><jointpos name="angle" joint="j"/></sensor></mujoco>
"""


def test_one_component_of_a_sensor() -> None:
    scene = load_scene(VECTOR)
    time = np.linspace(0, 1, 11)
    plain = Recording(time, {"sensor/gyro": np.ones((11, 3)), "sensor/angle": np.ones(11)})
    changed = [
        effect("sensor_scale", "gyro", {"axis": "y"}, factor=2.0),
        effect("sensor_bias", "j", offset=0.5),  # read by its sensor only
    ]
    found = distort(plain, changed, scene)
    np.testing.assert_array_equal(found["sensor/gyro"][3], [1, 2, 1])
    np.testing.assert_array_equal(found["sensor/angle"], np.full(11, 1.5))
