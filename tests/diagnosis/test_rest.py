"""`learn_rest`: a residual force for what no effect explains, kept only where it helps."""

import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import Diagnosis, Settings
from orbisim.effects import Hook, StepInputs, carried_effects
from orbisim.effects.residual_network import (
    Input,
    Network,
    carried_rest,
    features,
    rest_hooks,
    with_rest,
)
from orbisim.errors import InputError, SceneError
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"
FEW = Settings(effects=("sensor_bias",), retune=False)
"""A catalogue without anything that could explain the force below."""


class _Force(Hook):
    """A force at the elbow that is in no catalogue."""

    def __init__(self, law: Callable[[StepInputs], np.ndarray]) -> None:
        super().__init__({})
        self._law = law

    def force(self, inputs: StepInputs) -> None:
        inputs.qfrc[:, 1] += self._law(inputs)


def _diagnosed(law: Callable[[StepInputs], np.ndarray] | None) -> Diagnosis:
    arm = orbisim.load_scene(ARM)
    hooks = None if law is None else lambda _: [_Force(law)]
    runs = inject_effect(arm, [], duration=3.0, episodes=4, noise=2e-4, seed=2, hooks=hooks)
    return orbisim.diagnose(arm, runs, settings=FEW, learn_rest=True, progress=False)


@pytest.fixture(scope="module")
def damped() -> Diagnosis:
    return _diagnosed(lambda m: -0.15 * (1 + np.cos(3 * m.qpos[:, 1])) * m.qvel[:, 1])


def test_a_force_outside_the_catalogue_is_learned(damped: Diagnosis) -> None:
    assert damped.verdict == "unexplained"
    assert not damped.effects
    rest = damped.rest
    assert rest is not None
    assert [network.joint for network in rest.networks] == ["elbow"]
    assert rest.error["held_out"]["with"] < 0.2 * rest.error["held_out"]["without"]
    assert rest.error["held_out"]["without"] == damped.error["held_out"]["after"]
    assert rest.ratio["with"] < 0.2 * rest.ratio["without"]


def test_it_is_carried_and_applied(damped: Diagnosis, tmp_path: Path) -> None:
    damped.save(tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["effects"] == []
    assert "not a physical effect" in report["rest"]["label"]
    path = tmp_path / report["rest"]["scene"]
    mujoco.MjModel.from_xml_path(str(path))
    found = orbisim.replay(path, list(damped.held_out))
    assert found.rms == pytest.approx(report["rest"]["error"]["held_out"]["with"], rel=1e-3)
    plain = orbisim.replay(tmp_path / report["augmented_scene"], list(damped.held_out))
    assert plain.rms == pytest.approx(damped.error["held_out"]["after"], rel=1e-6)
    assert "residual force" in (tmp_path / "report.html").read_text()


def test_nothing_is_learned_without_a_residual() -> None:
    result = _diagnosed(None)
    assert result.verdict == "no_residual"
    assert result.rest is not None
    assert result.rest.scene is None
    assert "no_residual" in result.rest.reason


def test_what_does_not_help_is_not_kept() -> None:
    def timed(inputs: StepInputs) -> np.ndarray:  # nothing that is read tells this force
        t = inputs.time
        return 0.1 * (np.sin(37.0 * t) + np.sin(23.3 * t + 1.0) + np.sin(51.7 * t + 2.0))

    result = _diagnosed(timed)
    assert result.verdict == "unexplained"
    assert result.rest is not None
    assert result.rest.scene is None
    assert "not trained on" in result.rest.reason or "held-out" in result.rest.reason


def _network(scene: orbisim.Scene) -> Network:
    rng = np.random.default_rng(0)
    inputs = (Input("turn", "elbow"), Input("velocity", "shoulder"), Input("control", "1"))
    layers = ((rng.normal(size=(4, 5)), rng.normal(size=5)), (rng.normal(size=(5, 1)), np.ones(1)))
    return Network(
        "elbow", inputs, np.zeros(4), np.ones(4), -2 * np.ones(4), 2 * np.ones(4), layers
    )


def test_round_trip_and_bounds() -> None:
    arm = orbisim.load_scene(ARM)
    network = _network(arm)
    scene = with_rest(arm, [network])
    assert carried_effects(scene.model) == ()
    (read,) = carried_rest(scene.model)
    rng = np.random.default_rng(1)
    at = features(arm.model, read.inputs, *(rng.normal(size=(7, 2)) for _ in range(4)))
    np.testing.assert_allclose(read.force(at), network.force(at), rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(read.force(at * 0 + 2.0), read.force(at * 0 + 1e6))
    assert not rest_hooks(with_rest(scene, []).model)


def test_the_force_is_applied_at_its_joint() -> None:
    arm = orbisim.load_scene(ARM)
    network = _network(arm)
    backend = orbisim.make_backend("mujoco", with_rest(arm, [network]))
    after = backend.step(backend.reset(), np.zeros((1, 2)))
    data = mujoco.MjData(arm.model)
    zero = np.zeros((1, 2))
    data.qfrc_applied[1] = network.force(features(arm.model, network.inputs, *[zero] * 4))[0, 0]
    mujoco.mj_step(arm.model, data)
    np.testing.assert_allclose(after.qvel[0], data.qvel, rtol=1e-6)


def test_what_does_not_fit_is_refused() -> None:
    arm = orbisim.load_scene(ARM)
    spec = arm.spec
    spec.add_text(name="orbisim:rest", data='{"schema": "orbisim.rest/1", "forces": [{}]}')
    with pytest.raises(SceneError, match="orbisim:rest"):
        carried_rest(spec.compile())
    text = with_rest(arm, [_network(arm)]).to_xml().replace('"joint": "elbow"', '"joint": "wrist"')
    with pytest.raises(SceneError, match="wrist"):
        carried_rest(orbisim.load_scene(text).model)
    short = Network("elbow", (Input("position", "elbow"),), *[np.zeros(2)] * 4, layers=())
    with pytest.raises(InputError, match="one for each input"):
        with_rest(arm, [short])
