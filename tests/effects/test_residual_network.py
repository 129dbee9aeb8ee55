"""Learned residual forces: evaluated, carried, refused."""

from __future__ import annotations

import dataclasses
import json

import mujoco
import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend
from orbisim.effects.residual_network import (
    TEXT_NAME,
    Input,
    Network,
    carried_rest,
    features,
    rest_hooks,
    with_rest,
)
from orbisim.errors import InputError, OrbiSimError, SceneError
from orbisim.scene.texts import replace_text


def small(**changes: object) -> Network:
    """0.5 tanh(2 x) - 0.1 with x the speed of the elbow over 4, within +-0.5."""
    values: dict[str, object] = {
        "joint": "elbow",
        "inputs": (Input("velocity", "elbow"),),
        "centre": np.zeros(1),
        "scale": np.array([4.0]),
        "low": np.array([-0.5]),
        "high": np.array([0.5]),
        "layers": (
            (np.array([[2.0]]), np.zeros(1)),
            (np.array([[0.5]]), np.array([-0.1])),
        ),
    }
    return Network(**{**values, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("speed", [-9.0, -1.0, 0.0, 1.5, 9.0])
def test_the_force_is_the_networks(speed: float) -> None:
    inside = np.clip(speed / 4, -0.5, 0.5)
    expected = 0.5 * np.tanh(2 * inside) - 0.1
    np.testing.assert_allclose(small().force(np.array([[speed]])), [[expected]])


def test_the_force_acts_in_the_simulation(scene: Scene) -> None:
    changed = with_rest(scene, [small()])
    accelerations = []
    for one in (scene, changed):
        engine = make_backend("mujoco", one)
        engine.report = {"qacc"}
        state = engine.reset()
        qvel = np.array(state.qvel)
        qvel[0, 1] = 1.0
        after = engine.step(state.replace(qvel=qvel), np.zeros(2))
        accelerations.append(after.memory["qacc"][0])
    data, full = mujoco.MjData(scene.model), np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_forward(scene.model, data)
    mujoco.mj_fullM(scene.model, data, full)
    force = full @ (accelerations[1] - accelerations[0])
    expected = np.zeros(scene.model.nv)
    expected[1] = 0.5 * np.tanh(0.5) - 0.1
    np.testing.assert_allclose(force, expected, atol=1e-3)  # the integrator is implicit


def test_what_is_read(scene: Scene) -> None:
    model = scene.model
    inputs = [
        Input("turn", "shoulder"),
        Input("position", "elbow"),
        Input("velocity", "free"),
        Input("control", "1"),
        Input("force", "shoulder"),
        Input("pose", "free"),
    ]
    rng = np.random.default_rng(0)
    data = mujoco.MjData(model)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
    mujoco.mj_kinematics(model, data)
    qvel, ctrl, force = (rng.normal(size=(1, n)) for n in (model.nv, model.nu, model.nv))
    read = features(model, inputs, data.qpos[None], qvel, ctrl, force)[0]
    angle = data.qpos[0]
    ball = model.body("ball").id
    expected = [
        *(np.sin(angle), np.cos(angle), data.qpos[1]),
        *qvel[0, 2:8],
        *(ctrl[0, 1], force[0, 0]),
        *data.xpos[ball],
        *data.xmat[ball],
    ]
    np.testing.assert_allclose(read, expected, atol=1e-12)


def test_it_travels_in_the_mjcf(scene: Scene) -> None:
    changed = load_scene(with_rest(scene, [small()]).to_xml())
    (again,) = carried_rest(changed.model)
    assert again.to_json() == small().to_json()
    assert len(rest_hooks(changed.model)) == 1
    assert carried_rest(with_rest(changed, []).model) == ()
    assert rest_hooks(scene.model) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joint": "knee"}, "'knee'"),
        ({"joint": "free"}, "the last layer must give 6 numbers"),
        ({"scale": np.zeros(1)}, "scale must be positive"),
        ({"centre": np.zeros(2)}, "centre must hold 1 numbers"),
        ({"low": np.array([np.nan])}, "not finite"),
        ({"layers": ()}, "the last layer"),
        ({"layers": ((np.zeros((2, 1)), np.zeros(1)),)}, "it is given 1 numbers"),
        ({"inputs": (Input("control", "2"),)}, "no control number '2'; the scene has 2"),
        ({"inputs": (Input("pose", "elbow"),)}, "has no pose"),
        ({"inputs": (Input("turn", "free"),)}, "has no turn"),
        ({"inputs": (Input("smell", "elbow"),)}, "no such input: 'smell'"),  # type: ignore[arg-type]
    ],
)
def test_what_does_not_fit_is_refused(scene: Scene, changes: dict, message: str) -> None:
    wrong = dataclasses.replace(small(), **changes)
    with pytest.raises(OrbiSimError, match=message):
        with_rest(scene, [wrong])
    with pytest.raises(OrbiSimError, match=message):
        Network.from_json(wrong.to_json(), scene.model)


def test_what_is_no_network_is_refused(scene: Scene) -> None:
    with pytest.raises(InputError, match="not a learned force"):
        Network.from_json({"joint": "elbow"}, scene.model)
    for text in ("[]", json.dumps({"schema": "other/1"}), "no json"):
        spec = scene.spec
        replace_text(spec, TEXT_NAME, None)
        spec.add_text(name=TEXT_NAME, data=text)
        with pytest.raises(SceneError, match=TEXT_NAME):
            carried_rest(spec.compile())
