"""How a scene carries effects."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import Physics, Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, carried_effects
from orbisim.effects.carry import hooks_of
from orbisim.errors import InputError, SceneError, UnknownNameError

from .arm import ARM, CTRL, generalized_force, start

CARRIED = EffectInstance("linear_drag", "fore", {"coefficient": 0.4})


def test_effects_travel_in_the_mjcf(scene: Scene, tmp_path) -> None:
    changed = add_effects(scene, [CARRIED])
    path = changed.save(tmp_path)
    plain = mujoco.MjModel.from_xml_path(str(path))  # plain MuJoCo carries and ignores it
    assert plain.ntext == 1
    again = load_scene(path)
    assert carried_effects(again.model) == (CARRIED,)
    np.testing.assert_allclose(generalized_force(again), generalized_force(changed), atol=1e-9)
    further = add_effects(again, [EffectInstance("deadband", "m1", {"width": 0.1})])
    assert [e.effect for e in carried_effects(further.model)] == ["linear_drag", "deadband"]


def test_physics_applies_carried_effects(scene: Scene) -> None:
    changed = add_effects(scene, [CARRIED])
    for physics in (Physics.from_scene(changed), Physics.from_xml_string(changed.to_xml())):
        physics.data.qpos[:], physics.data.qvel[:] = start(scene.model)
        physics.set_control(CTRL)
        physics.step(50)
        engine = make_backend("mujoco", changed)
        qpos, qvel = start(scene.model)
        state = engine.reset().replace(qpos=qpos[None], qvel=qvel[None])
        expected = engine.step(state, CTRL, 50)
        np.testing.assert_allclose(physics.data.qpos, expected.qpos[0], atol=1e-12)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("not json", "Expecting value"),
        ('{"effect": 1}', "expected a list"),
        ('[{"effect": "linear_drag"}]', "not an effect"),
        ('[{"effect": "no_such", "target": "fore", "parameters": {}}]', "unknown effect"),
        ('[{"effect": "linear_drag", "target": "leg", "parameters": {"coefficient": 1}}]', "'leg'"),
        ('[{"effect": "linear_drag", "target": "fore", "parameters": {}}]', "lacks coefficient"),
        (
            '[{"effect": "linear_drag", "target": "fore", "parameters": {"coefficient": -1}}]',
            "within",
        ),
    ],
)
def test_unreadable_effects_are_refused(data: str, message: str) -> None:
    text = f"<custom><text name='orbisim:effects' data='{data}'/></custom></mujoco>"
    with pytest.raises(SceneError, match=message):
        load_scene(ARM.replace("</mujoco>", text))


def test_impossible_effects_are_refused(scene: Scene) -> None:
    for effect, target, values, error in (
        ("coulomb_friction", "knee", {"torque": 1}, UnknownNameError),
        ("coulomb_friction", "free", {"torque": 1}, InputError),
        ("coulomb_friction", "elbow", {"torque": -1}, InputError),
        ("coulomb_friction", "elbow", {"torque": float("nan")}, InputError),
        ("coulomb_friction", "elbow", {"torqe": 1}, UnknownNameError),
        ("colomb_friction", "elbow", {"torque": 1}, UnknownNameError),
        ("magnus", "fore", {"coefficient": 1}, InputError),
    ):
        with pytest.raises(error):
            add_effects(scene, [EffectInstance(effect, target, values)])


def test_hooks_are_those_of_effects_that_act_on_the_simulation(scene: Scene) -> None:
    biased = EffectInstance("sensor_bias", "elbow", {"offset": 0.1})
    assert len(hooks_of(add_effects(scene, [CARRIED, biased]).model)) == 1
    assert hooks_of(scene.model) == []


def test_what_cannot_be_edited_is_said(scene: Scene) -> None:
    with pytest.raises(InputError, match="cannot be edited"):
        add_effects(Scene.from_model(scene.model), [CARRIED])
