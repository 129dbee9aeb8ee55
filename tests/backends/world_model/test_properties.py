"""Properties by name: coupled as in the world, with gradients; entities and the hand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.backend import LearnedBackend
from orbisim_world_model.engine import ATTRIBUTES, SETTINGS
from orbisim_world_model.reading import read_attributes

from orbisim.errors import InputError, UnknownNameError, UnsupportedSceneError
from orbisim.registry import make_backend
from orbisim.scene import Scene, load_scene
from orbisim.state import State


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("task:push")


@pytest.fixture(scope="module")
def backend(scene: Scene) -> LearnedBackend:
    made = make_backend("learned", scene, device="cpu", native=False)
    assert isinstance(made, LearnedBackend)
    return made


def test_a_density_is_that_of_an_edited_scene(scene: Scene, backend: LearnedBackend) -> None:
    spec = scene.spec.copy()
    spec.geom("cube1").density = 750.0
    expected = read_attributes(spec.compile(), backend.engine.layout)
    state = backend.with_properties(backend.reset(2), {"cube1": {"density": 750.0}})
    np.testing.assert_allclose(state.memory[ATTRIBUTES][1], expected, rtol=1e-5)


def test_values_by_world_and_changes_of_changes(backend: LearnedBackend) -> None:
    state = backend.with_properties(backend.reset(2), world={"friction_slide": [0.2, 0.5]})
    state = backend.with_properties(state, {"cube2": {"friction_slide": 0.3, "mass": 0.1}})
    layout = backend.engine.layout
    column = layout.settings.index("friction_slide")
    np.testing.assert_allclose(state.memory[SETTINGS][:, column], [0.2, 0.5])
    mass = state.memory[ATTRIBUTES][:, 1, layout.attributes.index("mass")]
    np.testing.assert_allclose(mass, 0.1)


def test_a_step_has_a_gradient_to_a_friction_coefficient(backend: LearnedBackend) -> None:
    friction = torch.tensor(0.4, requires_grad=True)
    start = backend.reset(1)
    sliding = np.array(start.qvel)
    sliding[0, -6] = 0.5  # the second cube slides
    state = backend.with_properties(start.replace(qvel=sliding), world={"friction_slide": friction})
    after = backend.step(state, np.array(backend.model.key_ctrl[:1]))
    (gradient,) = torch.autograd.grad(after.qvel[0, -6], friction)
    assert gradient < 0  # rougher is slower


@pytest.mark.parametrize(
    ("objects", "world", "error", "says"),
    [
        ({"cub1": {"mass": 1.0}}, None, UnknownNameError, "did you mean 'cube1'"),
        ({"cube1": {"masss": 1.0}}, None, UnknownNameError, "did you mean 'mass'"),
        ({"cube1": {"half_x": 0.1}}, None, InputError, "edit the scene"),
        ({"cube1": {"mass": -1.0}}, None, InputError, "above 0"),
        ({"cube1": {"mass": [1.0] * 3}}, None, InputError, "each of 2 worlds"),
        (None, {"friction": 1.0}, UnknownNameError, "friction_slide"),
        (None, {"gravity_z": float("nan")}, InputError, "finite"),
    ],
)
def test_what_makes_no_sense_is_refused(
    backend: LearnedBackend, objects: object, world: object, error: type, says: str
) -> None:
    with pytest.raises(error, match=says):
        backend.with_properties(backend.reset(2), objects, world)  # type: ignore[arg-type]


def test_hand_and_objects_are_mujocos(scene: Scene, backend: LearnedBackend) -> None:
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel[:] = np.linspace(-0.5, 0.5, model.nv)
    mujoco.mj_forward(model, data)
    state = State(np.zeros(1), data.qpos[None].copy(), data.qvel[None].copy(), np.zeros((1, 0)))
    hand = backend.hand(state)
    site = model.site("tcp").id
    np.testing.assert_allclose(hand.pos[0], data.site_xpos[site], atol=1e-5)
    np.testing.assert_allclose(hand.rot[0].ravel(), data.site_xmat[site], atol=1e-5)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 0)
    np.testing.assert_allclose(hand.vel[0], velocity[3:], atol=1e-5)
    np.testing.assert_allclose(hand.ang[0], velocity[:3], atol=1e-5)
    pos = backend.entities(state).pos[0]
    np.testing.assert_allclose(pos[0], data.xpos[model.body("cube1").id], atol=1e-6)


def test_the_hand_has_a_gradient_to_the_joints(backend: LearnedBackend) -> None:
    start = backend.reset(1)
    qpos = torch.tensor(start.qpos, dtype=torch.float32, requires_grad=True)
    (gradient,) = torch.autograd.grad(backend.hand(start.replace(qpos=qpos)).pos[0, 2], qpos)
    assert gradient[0, :6].abs().max() > 0.1


def test_without_a_hand_there_is_none() -> None:
    cart = make_backend("learned", load_scene("suite:cartpole-swingup"), native=False, device="cpu")
    assert isinstance(cart, LearnedBackend)
    with pytest.raises(UnsupportedSceneError, match="no hand"):
        cart.hand(cart.reset(1))
