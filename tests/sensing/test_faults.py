"""Faults of sensors that do not read the joints themselves, and joints that only sensors read."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import Diagnosis, Settings
from orbisim.effects import EffectInstance, carried_effects
from orbisim.effects.measured import correct, distort
from orbisim.errors import InputError
from orbisim.recording import Recording, bind
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"
FEW = Settings(effects=("coulomb_friction", "sensor_bias", "sensor_delay"), retune=False)


@pytest.fixture(scope="module")
def arm() -> orbisim.Scene:
    spec = mujoco.MjSpec.from_file(str(ARM))
    spec.body("forearm").add_site(name="imu", pos=[0, 0, -0.2])
    site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": "imu"}
    for name, kind in (("gyro", "GYRO"), ("accelerometer", "ACCELEROMETER"), ("force", "FORCE")):
        spec.add_sensor(name=name, type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), **site)
    for joint in ("shoulder", "elbow"):
        for name, kind in (("angle", "JOINTPOS"), ("speed", "JOINTVEL")):
            spec.add_sensor(
                name=f"{joint}_{name}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint,
            )
    return orbisim.Scene.from_spec(spec)


def _runs(arm: orbisim.Scene, *effects: EffectInstance, seed: int = 5) -> list[Recording]:
    return inject_effect(
        arm,
        effects,
        duration=2.0,
        episodes=4,
        noise=1e-4,
        sensors=True,
        sensor_noise=2e-3,
        seed=seed,
    )


def _diagnosed(arm: orbisim.Scene, *effects: EffectInstance) -> Diagnosis:
    return orbisim.diagnose(arm, _runs(arm, *effects), settings=FEW, progress=False)


def _found(result: Diagnosis) -> dict[tuple[str, str], float]:
    return {(e.effect, e.target): next(iter(e.parameters.values())).value for e in result.effects}


@pytest.mark.parametrize(
    ("effect", "target", "value"),
    [
        ("sensor_scale", "accelerometer", {"factor": 1.03}),
        ("sensor_delay", "gyro", {"delay": 0.02}),
        ("sensor_scale", "force", {"factor": 0.95}),
        ("sensor_bias", "elbow_angle", {"offset": -0.01}),
    ],
)
def test_finds_what_is_wrong_with_a_sensor(
    arm: orbisim.Scene, effect: str, target: str, value: dict[str, float]
) -> None:
    result = _diagnosed(arm, EffectInstance(effect, target, value))
    assert result.verdict == "explained"
    expected = {(effect, target): pytest.approx(next(iter(value.values())), rel=0.05)}
    assert _found(result) == expected
    (one,) = result.effects
    estimate = next(iter(one.parameters.values()))
    assert estimate.ci95[0] < estimate.value < estimate.ci95[1]
    assert one.evidence["held_out_error_with"] < one.evidence["held_out_error_without"]
    assert result.residual["where"][0]["target"] == target
    assert result.noise[f"sensor/{target}"] == pytest.approx(2e-3, rel=0.1)


@pytest.mark.slow
def test_one_axis_and_two_faults_at_once(arm: orbisim.Scene, tmp_path: Path) -> None:
    bias = EffectInstance("sensor_bias", "gyro", {"offset": 0.03}, {"axis": "z"})
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    result = _diagnosed(arm, bias, friction)
    assert {(e.effect, e.target, e.options.get("axis")) for e in result.effects} == {
        ("coulomb_friction", "elbow", None),
        ("sensor_bias", "gyro", "z"),
    }
    assert result.verdict == "explained"
    result.save(tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["noise_units"]["sensor/accelerometer"] == "m/s^2"
    assert report["effects"][1]["error_unit"] == "rad/s"
    model = mujoco.MjModel.from_xml_path(str(tmp_path / report["augmented_scene"]))
    assert carried_effects(model)[0].options == {"axis": "z"}
    assert "gyro" in (tmp_path / "report.html").read_text()


def test_silent_about_sensors_that_are_right(arm: orbisim.Scene) -> None:
    result = _diagnosed(arm)
    assert result.verdict == "no_residual"
    assert result.effects == ()
    ratios = {s["target"]: s["ratio_to_noise"] for s in result.residual["sensors"]}
    assert ratios.keys() >= {"gyro", "accelerometer", "force"}
    assert max(ratios.values()) < 1.2


def test_a_fault_of_no_known_form_is_not_named(arm: orbisim.Scene) -> None:
    runs = [
        one.replace(signals={**one.signals, "sensor/gyro": one["sensor/gyro"] ** 2})
        for one in _runs(arm)
    ]
    result = orbisim.diagnose(arm, runs, settings=FEW, progress=False)
    assert result.verdict == "unexplained"
    assert result.effects == ()
    assert "sensor 'gyro' deviates" in result.sentence


def test_the_joints_may_be_known_from_sensors_alone(arm: orbisim.Scene) -> None:
    late = EffectInstance("sensor_bias", "elbow", {"offset": 0.05})
    runs = [one.select(lambda n: n.startswith(("ctrl", "sensor"))) for one in _runs(arm)]
    bound = bind(runs[0], arm)
    np.testing.assert_array_equal(bound.qpos[:, 1], runs[0]["sensor/elbow_angle"])
    np.testing.assert_array_equal(bound.qvel[:, 0], runs[0]["sensor/shoulder_speed"])
    assert any("elbow_angle" in note for note in bound.notes)
    moved = distort(runs[0], [late], arm)
    np.testing.assert_allclose(moved["sensor/elbow_angle"], runs[0]["sensor/elbow_angle"] + 0.05)
    np.testing.assert_array_equal(moved["sensor/elbow_speed"], runs[0]["sensor/elbow_speed"])
    back = correct(moved, [late], arm)
    np.testing.assert_allclose(back["sensor/elbow_angle"], runs[0]["sensor/elbow_angle"])
    result = orbisim.diagnose(
        arm, [distort(one, [late], arm) for one in runs], settings=FEW, progress=False
    )
    assert _found(result) == {("sensor_bias", "elbow"): pytest.approx(0.05, rel=0.05)}


def test_an_axis_that_a_sensor_lacks_is_refused(arm: orbisim.Scene) -> None:
    (run, *_) = _runs(arm)
    wrong = EffectInstance("sensor_bias", "elbow_angle", {"offset": 0.1}, {"axis": "x"})
    with pytest.raises(InputError, match="one component"):
        distort(run, [wrong], arm)
    wrong = EffectInstance("sensor_bias", "gyro", {"offset": 0.1}, {"axis": "w"})
    with pytest.raises(InputError, match="x, y, z"):
        distort(run, [wrong], arm)
