"""The diagnosis end to end: what it finds, when it is silent, what it writes, what it refuses."""

import dataclasses
import hashlib
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import Diagnosis
from orbisim.effects import EffectInstance
from orbisim.errors import RecordingError
from orbisim.recording import Recording
from orbisim.shooting.history import HistoryDependent
from orbisim.shooting.stepping import Stepping, with_stepping
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2"
SHORT = {"duration": 4.0, "episodes": 4, "noise": 2e-4}


@pytest.fixture(scope="module")
def example(arm: orbisim.Scene) -> Diagnosis:
    runs = sorted((ARM / "example").glob("*.npz"))
    return orbisim.diagnose(ARM / "scene.xml", runs, progress=False)


@pytest.fixture(scope="module")
def saved(example: Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("example")
    example.save(folder)
    return folder


def test_finds_the_friction_of_the_example(example: Diagnosis) -> None:
    (effect,) = example.effects
    assert (effect.effect, effect.target) == ("coulomb_friction", "elbow")
    torque = effect.parameters["torque"]
    assert torque.value == pytest.approx(0.12, rel=0.01)
    assert torque.ci95[0] < torque.value < torque.ci95[1]
    assert example.verdict == "explained"
    held = example.error["held_out"]
    assert held["after"] < 0.05 * held["before"]
    assert effect.evidence["held_out_error_without"] > 10 * effect.evidence["held_out_error_with"]
    assert example.residual["where"][0]["target"] == "elbow"
    assert "'elbow' lacks Coulomb friction" in example.sentence


def test_the_verdict_names_joints_that_depend_on_their_history(example: Diagnosis) -> None:
    joint = HistoryDependent("elbow", (0, 2.0), (0, 3.5), 4.0)
    told = dataclasses.replace(example, history=(joint,))
    assert told.sentence == f"{example.sentence} {joint.told}."
    assert "'elbow' is history-dependent" in told.sentence
    assert "history" not in example.sentence


def test_held_out_recordings_are_not_fitted(example: Diagnosis) -> None:
    fit = {one.source for one in example.fit}
    held = {one.source for one in example.held_out}
    assert held
    assert not fit & held


def test_files(saved: Path) -> None:
    report = json.loads((saved / "report.json").read_text())
    assert report["schema"] == "orbisim.diagnosis/1"
    assert {"scene", "recordings", "noise", "residual", "verdict", "effects"} <= report.keys()
    assert {"alternatives", "error", "augmented_scene"} <= report.keys()
    assert report["effects"][0]["native"] is True
    model = mujoco.MjModel.from_xml_path(str(saved / report["augmented_scene"]))
    assert model.joint("elbow").frictionloss[0] == pytest.approx(0.12, rel=0.01)
    page = (saved / "report.html").read_text()
    assert "Coulomb friction" in page
    assert "src=" not in page.split("</head>")[0]


def test_what_it_was_made_from(example: Diagnosis) -> None:
    def digest(path: str) -> str:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()

    origin = example.to_json()["origin"]
    assert origin["versions"]["mujoco"] == mujoco.__version__
    assert origin["scene"]["sha256"] == digest(example.source)
    assert origin["scene"]["model_sha256"] == example.scene.fingerprint
    names = [one.source for one in (*example.fit, *example.held_out)]
    assert origin["sha256"] == {name: digest(name) for name in names}


def test_the_augmented_scene_replays_as_reported(example: Diagnosis, saved: Path) -> None:
    found = orbisim.replay(saved / "augmented" / "scene.xml", list(example.held_out))
    assert found.rms == pytest.approx(example.error["held_out"]["after"], rel=1e-6)


def test_silent_without_an_effect(arm: orbisim.Scene) -> None:
    result = orbisim.diagnose(arm, inject_effect(arm, [], seed=3, **SHORT), progress=False)
    assert result.verdict == "no_residual"
    assert not result.effects
    assert not result.residual["significant"]
    assert result.residual["ratio_to_noise"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow  # a search by itself: tests/diagnosis/test_sensors.py
def test_an_effect_of_the_sensor() -> None:
    scene = orbisim.load_scene(ARM.parent / "cart_pole" / "scene.xml")
    late = EffectInstance("sensor_delay", "pole", {"delay": 0.015})
    runs = inject_effect(scene, late, seed=4, **(SHORT | {"duration": 2.0}))
    result = orbisim.diagnose(scene, runs, progress=False)
    assert [(e.effect, e.target) for e in result.effects] == [("sensor_delay", "pole")]
    assert result.effects[0].parameters["delay"].value == pytest.approx(0.015, rel=0.05)
    assert "orbisim:effects" in result.augmented_scene.to_xml()


def _changed(recording: Recording, **signals: np.ndarray) -> Recording:
    named = {name.replace("__", "/"): values for name, values in signals.items()}
    return recording.replace(signals={**recording.signals, **named})


def test_refuses_wrong_recordings(arm: orbisim.Scene) -> None:
    (good,) = inject_effect(arm, [], duration=2.0, episodes=1)
    elbow, shoulder = good["qvel/elbow"], good["qvel/shoulder"]
    wrong = {
        "swap": _changed(good, qvel__elbow=shoulder, qvel__shoulder=elbow),
        "all": _changed(good, qpos__elbow=np.full(len(good), 0.3), qvel__elbow=0 * elbow),
        "degrees": _changed(good, qvel__elbow=np.degrees(elbow)),
        "sign": _changed(good, qvel__elbow=-elbow),
    }
    for word, recording in wrong.items():
        with pytest.raises(RecordingError, match=word):
            orbisim.diagnose(arm, recording, progress=False)
    with pytest.raises(RecordingError, match="one sample"):
        orbisim.diagnose(arm, good.rows(slice(0, 1)), progress=False)


def test_a_scene_with_longer_steps_than_samples_is_augmented_with_those_taken(
    arm: orbisim.Scene,
) -> None:
    euler = int(mujoco.mjtIntegrator.mjINT_EULER)
    long, true = (with_stepping(arm, Stepping(step, euler)) for step in (0.02, 0.01))
    few = orbisim.diagnosis.Settings(retune=False, effects=("viscous_damping", "torque_gain"))
    for effects, step in (
        ([], 0.02),
        ([EffectInstance("viscous_damping", "elbow", {"coefficient": 0.08})], 0.01),
    ):
        runs = inject_effect(true, effects, rate=100.0, seed=0, **SHORT)
        found = orbisim.diagnose(long, runs, settings=few, progress=False)
        assert [one.effect for one in found.effects] == [one.effect for one in effects]
        assert found.augmented_scene.model.opt.timestep == pytest.approx(step)
        assert any(
            "samples are closer than the declared timestep of 0.02 s" in n for n in found.notes
        )


def test_samples_that_are_left_out_do_not_lengthen_steps(arm: orbisim.Scene) -> None:
    euler = int(mujoco.mjtIntegrator.mjINT_EULER)
    long, true = (with_stepping(arm, Stepping(step, euler)) for step in (0.02, 0.005))
    runs = inject_effect(true, [], rate=200.0, seed=0, **SHORT)
    few = orbisim.diagnosis.Settings(retune=False, effects=("viscous_damping",))
    found = orbisim.diagnose(long, runs, settings=few, window=1.5, progress=False)
    assert any("more than 200 samples" in note for note in found.notes)
    assert any("free runs take a timestep of 0.005 s" in note for note in found.notes)
    assert found.verdict == "no_residual"
