"""A step of a cloth: what is known, what is learned, and their symmetries."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from orbisim_world_model.cloth.config import ClothModel
from orbisim_world_model.cloth.constraints import middles, projected
from orbisim_world_model.cloth.dynamics import ClothDynamics, rolled
from orbisim_world_model.cloth.evaluate import strain
from orbisim_world_model.cloth.mesh import Cloth, Mesh, read_mesh
from orbisim_world_model.cloth.shape import headings
from orbisim_world_model.cloth.solids import nearest
from orbisim_world_model.cloth.trainer import ClothTrainer
from torch import Tensor

from orbisim import load_scene
from orbisim.errors import UnsupportedSceneError
from orbisim.testing import scenes
from tests.backends.world_model.cloth.falls import STEP, falls, toy_cloth

BALL = '<body pos="1 1 1"><freejoint/><geom size=".1"/></body>'
EDGE = '<edge equality="true" solref="0.01 1" damping="0.01"/>'
SMALL = ClothModel(width=16, layers=2)


def _shaken(model: ClothDynamics) -> ClothDynamics:
    """With weights that say something."""
    torch.manual_seed(3)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return model.eval()


def _turn(angle: float, mirror: float = 1.0) -> Tensor:
    c, s = np.cos(angle), np.sin(angle)
    return torch.tensor([[[c, -s * mirror, 0], [s, c * mirror, 0], [0, 0, 1]]], dtype=torch.float32)


def test_a_state_becomes_a_cloth_and_a_state_again() -> None:
    model = load_scene(scenes.CLOTH).model
    mesh = read_mesh(model, STEP)
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((2, 3, model.nq))
    qpos, qvel = torch.as_tensor(rows, dtype=torch.float32)
    x = mesh.split(qpos, qvel)
    back = mesh.join(x)
    torch.testing.assert_close(back[0], qpos)
    torch.testing.assert_close(back[1], qvel)
    at_rest = mesh.split(torch.zeros(1, mesh.nq), torch.zeros(1, mesh.nv)).pos
    assert float(strain(mesh, at_rest).max()) < 1e-5


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (scenes.CARTPOLE, "one flex"),
        (scenes.CLOTH.replace("<flexcomp", f"{BALL}<flexcomp"), "7 coordinates"),
        (scenes.CLOTH.replace(EDGE, ""), "lengths"),
    ],
)
def test_what_is_no_cloth_alone_is_refused(text: str, match: str) -> None:
    with pytest.raises(UnsupportedSceneError, match=match):
        read_mesh(load_scene(text).model, STEP)


def test_before_training_a_graph_falls_and_keeps_its_edges() -> None:
    data = falls()
    start = data.x.at((slice(None), 0))
    fresh = ClothDynamics(SMALL, data.mesh)
    known = ClothDynamics(dataclasses.replace(SMALL, kind="ballistic"), data.mesh)
    with torch.no_grad():
        ours, theirs = (rolled(m, start, data.solids, 5) for m in (fresh, known))
    torch.testing.assert_close(ours.pos, theirs.pos)


def _projected(mesh: Mesh, places: Tensor, began: Tensor, friction: float = 0.0) -> Tensor:
    data = falls()
    near = nearest(data.solids.at(slice(0, 1)), torch.cat([places, middles(mesh, places)], dim=1))
    return projected(mesh, places, began, near, torch.tensor([friction]), 60)


def test_stretched_edges_shrink() -> None:
    data = falls()
    places = data.x.pos[:1, 0] * torch.tensor([1.2, 1.0, 1.0])
    assert float(strain(data.mesh, places).max()) > 0.15
    assert float(strain(data.mesh, _projected(data.mesh, places, places)).max()) < 0.03


def test_what_is_inside_comes_out_and_slides_less() -> None:
    data = falls()
    began = data.x.pos[:1, 0] * torch.tensor([1.0, 1.0, 0.0]) + torch.tensor([1.0, 0.0, 0.007])
    sunk = began + torch.tensor([0.002, 0.0, -0.01])  # into the floor, and along it
    for friction, slides in ((0.0, 0.002), (0.1, 0.0011), (1.0, 0.0)):
        after = _projected(data.mesh, sunk, began, friction)
        np.testing.assert_allclose(after[..., 2], data.mesh.radius, atol=1e-5)
        np.testing.assert_allclose(after[..., 0] - began[..., 0], slides, atol=2e-5)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_turned_frame_turns_what_the_network_says(mirror: float) -> None:
    """What is trained in turned frames is the step in the world's frame of a turned world."""
    data = falls()
    model = _shaken(ClothDynamics(dataclasses.replace(SMALL, projections=0), data.mesh))
    x = data.x.at((slice(0, 1), 8))
    turn, far = _turn(0.7, mirror), data.solids.at(slice(0, 1))
    plane = far._replace(centre=far.centre - 50.0)  # the floor alone looks the same, turned
    turned = Cloth(*(field @ turn for field in x))
    with torch.no_grad():
        seen = model(x, plane, turn)
        direct = model(turned, plane)
    torch.testing.assert_close(seen.pos @ turn, direct.pos, atol=1e-5, rtol=0)
    torch.testing.assert_close(seen.vel @ turn, direct.vel, atol=1e-4, rtol=0)


@pytest.mark.parametrize("name", ["cloth", "cloth_shape", "cloth_free"])
def test_gradients_of_a_step_match_differences(name: str) -> None:
    data = falls()
    trainer = ClothTrainer(data, toy_cloth(name), 0)
    model = _shaken(trainer.model).double()
    model.mesh = dataclasses.replace(
        data.mesh, rest=data.mesh.rest.double(), gravity=data.mesh.gravity.double()
    )
    solids = type(data.solids)(*(field[:1].double() for field in data.solids))
    x = Cloth(*(field[:1, 6].double() for field in data.x))
    pos, way = x.pos.clone().requires_grad_(), torch.randn_like(x.pos)
    (slope,) = torch.autograd.grad(model(Cloth(pos, x.vel), solids).pos.square().sum(), pos)
    eps = 1e-6
    with torch.no_grad():
        ahead, behind = (
            model(Cloth(x.pos + sign * eps * way, x.vel), solids).pos.square().sum()
            for sign in (1, -1)
        )
    assert float((slope * way).sum()) == pytest.approx(float(ahead - behind) / (2 * eps), rel=1e-3)


def test_the_heading_of_a_turned_cloth_is_the_turn() -> None:
    data = falls()
    flat = data.mesh.flat[None] @ _turn(0.9).transpose(1, 2) + 3.0
    torch.testing.assert_close(headings(data.mesh, flat), _turn(0.9), atol=1e-5, rtol=0)


def test_a_shape_feature_turns_back_into_the_vertices_it_was_made_of() -> None:
    """With as many components as the data have, a step loses nothing but what they do not span."""
    data = falls()
    config = toy_cloth("cloth_shape", model__codes="40")
    model = ClothTrainer(data, config, 0).model.eval()
    x = Cloth(*(field[:, 5] for field in data.x))
    known = ClothDynamics(ClothModel("ballistic", projections=0), data.mesh)
    with torch.no_grad():
        after, fallen = model(x, data.solids), known(x, data.solids)
    assert float((after.pos - fallen.pos).norm(dim=-1).max()) < 2e-3
