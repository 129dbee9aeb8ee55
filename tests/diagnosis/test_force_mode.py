"""The diagnosis of forces: several effects at once, and silence."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.force_data import ForceData, candidates, force_data, spread
from orbisim.diagnosis.force_result import _implausible
from orbisim.diagnosis.force_search import (
    _idle,
    _slopes,
    attribute_forces,
    common_forces,
    fit_forces,
)
from orbisim.diagnosis.settings import Settings
from orbisim.effects import EffectInstance, find
from orbisim.errors import InputError
from orbisim.host.deadline import Deadline
from orbisim.motion.samples import forces_known, prepare_all
from orbisim.recording import Recording
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.testing import inject_effect


def recorded(arm: orbisim.Scene, *effects: EffectInstance) -> list[Recording]:
    return inject_effect(arm, effects, duration=3.0, episodes=3, noise=1e-4, seed=5)


def test_finds_several_effects_at_once(
    arm: orbisim.Scene, several: tuple[EffectInstance, ...], tmp_path: Path
) -> None:
    found = orbisim.diagnose(
        arm, recorded(arm, *several), residual="force", out=tmp_path, progress=False
    )
    named = {(e.effect, e.target): next(iter(e.parameters.values())) for e in found.effects}
    assert set(named) == {(e.effect, e.target) for e in several}
    for truth in several:
        value = next(iter(truth.values.values()))
        assert named[truth.effect, truth.target].value == pytest.approx(value, rel=0.1)
    held = found.error["held_out"]
    assert held["after"] < 0.4 * held["before"]
    assert found.error["unit"] == "N*m"
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["error"]["residual"] == "force"
    assert "missing force on held-out data falls" in report["sentence"]
    assert "--residual force" in (tmp_path / "report.html").read_text()


def test_silent_without_an_effect(arm: orbisim.Scene) -> None:
    found = orbisim.diagnose(arm, recorded(arm), residual="force", progress=False)
    assert not found.effects
    assert found.error["held_out"]["after"] == found.error["held_out"]["before"]


def test_an_unknown_force_gets_no_name(arm: orbisim.Scene) -> None:
    """A force at the shoulder that follows no law of the catalogue."""
    from orbisim.effects import Hook, StepInputs

    class Wander(Hook):
        def force(self, inputs: StepInputs) -> None:
            t = np.asarray(inputs.time)
            inputs.qfrc[:, 0] += 0.5 * np.sin(3.1 * t + 2 * np.sin(1.7 * t) + np.sin(5.3 * t))

    runs = inject_effect(
        arm, [], duration=4.0, episodes=4, noise=1e-4, seed=6, hooks=lambda _: [Wander({})]
    )
    found = orbisim.diagnose(arm, runs, residual="force", progress=False)
    assert found.verdict == "unexplained"
    assert not found.effects


def test_noise_beyond_the_machine_is_said(arm: orbisim.Scene) -> None:
    one = ForceData(
        arm, (), 1, np.zeros((4, 2)), np.array([[0.1, 9.0]] * 4), np.ones((4, 2)), np.zeros(4, int)
    )
    notes = _implausible(arm, SimpleNamespace(data=one))  # type: ignore[arg-type]
    assert len(notes) == 1 and "'elbow'" in notes[0] and "positions jump" in notes[0]


def test_what_no_force_shows_is_not_fitted_but_dropped() -> None:
    """The distal link is a point on its own axis: its joint's dry friction needs an inertia to be
    seen by inverse dynamics, and an offset along the axis moves nothing."""
    scene = orbisim.load_scene(
        "<mujoco><worldbody><body><joint name='one' axis='0 1 0'/>"
        "<geom type='capsule' fromto='0 0 0 0 0 -.3' size='.02' mass='1'/>"
        "<body name='tip' pos='0 0 -.3'><joint name='two' axis='0 0 1'/>"
        "<inertial pos='0 0 -.05' mass='.2' diaginertia='1e-6 1e-6 1e-6'/></body></body>"
        "</worldbody><actuator><motor name='one' joint='one'/><motor name='two' joint='two'/>"
        "</actuator></mujoco>"
    )
    truth = EffectInstance("viscous_damping", "one", {"coefficient": 0.1})
    runs = inject_effect(scene, truth, duration=3.0, episodes=1, noise=1e-4, seed=2)
    data = force_data(scene, prepare_all(runs, scene), 300)
    both = (truth, EffectInstance("coulomb_friction", "two", {"torque": 0.3}))
    fitted, fit = fit_forces(data, Hypothesis(both), spread(data, data.force))
    assert fitted.effects[0].values["coefficient"] == pytest.approx(0.1, rel=0.1)
    assert fitted.effects[1].values["torque"] < 10
    assert [_idle(fitted, fit, number, scene) for number in range(2)] == [False, True]


def test_a_drive_that_another_joint_turns_shows_in_forces(arm: orbisim.Scene) -> None:
    """By velocity and position, as of a coupled wrist; what drives another joint does not show."""
    wrist = EffectInstance(
        "joint_coupling", "elbow", {"coefficient": -0.3}, {"other": "shoulder", "by": "velocity"}
    )
    samples = prepare_all(recorded(arm, wrist), arm)
    found, columns = candidates(force_data(arm, samples), ["joint_coupling"])
    assert {one.options["by"] for one in found} == {"velocity", "position"}
    assert columns.shape[2] == len(found)
    few = Settings(effects=("joint_coupling", "viscous_damping", "coulomb_friction"))
    (named,) = attribute_forces(arm, samples, few).hypothesis.effects
    assert (named.effect, named.target) == ("joint_coupling", "elbow")
    assert named.options == wrist.options
    assert named.values["coefficient"] == pytest.approx(-0.3, rel=0.05)


def test_what_every_machine_has_is_fitted_to_forces_at_once(arm: orbisim.Scene) -> None:
    """The largest first, and no less than there can be: declared damping may be too much."""
    friction = EffectInstance("coulomb_friction", "shoulder", {"torque": 0.2})
    rotor = EffectInstance("armature", "elbow", {"inertia": 0.02})
    samples = prepare_all(recorded(arm, friction, rotor), arm)
    found = common_forces(arm, samples, None, 20)
    assert {(one.effect, one.target) for one in found[:2]} == {
        ("coulomb_friction", "shoulder"),
        ("armature", "elbow"),
    }
    values = {(one.effect, one.target): next(iter(one.values.values())) for one in found}
    assert values["coulomb_friction", "shoulder"] == pytest.approx(0.2, rel=0.1)
    assert values["viscous_damping", "elbow"] > -float(arm.model.joint("elbow").damping[0])
    assert values.get(("coulomb_friction", "elbow"), 0.0) >= 0
    assert len(common_forces(arm, samples, None, 1)) == 1
    assert common_forces(arm, samples, ["payload"], 20) == ()


def test_what_every_machine_has_has_one_number(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(find("payload")), "common", True)
    with pytest.raises(TypeError, match="'payload' is `common` and has several numbers"):
        common_forces(arm, prepare_all(recorded(arm), arm), ["payload"], 20)


def test_a_fit_of_forces_ends_at_its_deadline(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the step that it is at, with what that gave."""
    truth = EffectInstance("coulomb_friction", "elbow", {"torque": 0.5})
    data = force_data(arm, prepare_all(recorded(arm, truth), arm), 300)
    begun, sigma = Hypothesis((truth.replace(torque=2.0),)), spread(data, data.force)
    steps: list[Hypothesis] = []

    def counted(data: ForceData, here: Hypothesis, *rest: np.ndarray) -> np.ndarray:
        steps.append(here)
        return _slopes(data, here, *rest)

    monkeypatch.setattr("orbisim.diagnosis.force_search._slopes", counted)
    whole, _ = fit_forces(data, begun, sigma)
    taken = len(steps)
    ended, fit = fit_forces(data, begun, sigma, Deadline(0.0))
    assert len(steps) - taken == 2 < taken  # one step, and where it led
    assert ended.effects[0].values["torque"] == pytest.approx(0.5, rel=0.1)
    assert whole.effects[0].values["torque"] == pytest.approx(0.5, rel=0.1)
    assert np.isfinite(fit.covariance).all()


def test_no_time_for_forces_is_said(arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orbisim.diagnosis.run._leaves_something", lambda _: True)
    runs = recorded(arm, EffectInstance("coulomb_friction", "elbow", {"torque": 0.5}))
    few = Settings(effects=("coulomb_friction",), retune=False, patience=0.1)
    found = orbisim.diagnose(arm, runs, settings=few, progress=False)
    assert any("time was up before the forces" in note for note in found.notes)


def test_refuses_an_unknown_residual(arm: orbisim.Scene) -> None:
    with pytest.raises(InputError, match="'motion' or 'force'"):
        orbisim.diagnose(arm, recorded(arm), residual="torque", progress=False)  # type: ignore[arg-type]


def test_a_learned_rest_belongs_to_the_motion(arm: orbisim.Scene) -> None:
    with pytest.raises(InputError, match="learn_rest goes with residual='motion'"):
        orbisim.diagnose(arm, recorded(arm), residual="force", learn_rest=True, progress=False)


def test_a_control_that_is_not_recorded_is_no_known_force(arm: orbisim.Scene) -> None:
    whole = recorded(arm)[0]
    blind = Recording(
        time=whole.time,
        signals={name: x for name, x in whole.signals.items() if not name.startswith("ctrl")},
    )
    assert forces_known(arm, prepare_all([whole], arm))
    assert not forces_known(arm, prepare_all([blind], arm))
