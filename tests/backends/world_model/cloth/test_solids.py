"""Signed distances are MuJoCo's, and normals are their gradients."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.cloth.solids import Solids, joined, nearest, read_solids

from orbisim import load_scene
from orbisim.errors import UnsupportedSceneError
from orbisim.tasks.drape import Drape

FLEX = (
    '<flexcomp name="c" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2" radius=".01" '
    'pos="0 0 3"><edge equality="true"/></flexcomp>'
)
SHAPES = {
    "box": 'type="box" size=".2 .1 .15" euler="20 30 40"',
    "ball": 'type="sphere" size=".2"',
    "cylinder": 'type="cylinder" size=".15 .2" euler="50 10 0"',
    "capsule": 'type="capsule" size=".1 .15" euler="50 10 0"',
    "plane": 'type="plane" size="1 1 .1" euler="10 0 0"',
}


def _scene(geoms: str) -> mujoco.MjModel:
    return load_scene(f"<mujoco><worldbody>{geoms}{FLEX}</worldbody></mujoco>").model


def _reference(spec: mujoco.MjSpec, points: np.ndarray) -> np.ndarray:
    """Distances by MuJoCo, from a ball of 1 mm."""
    spec = spec.copy()
    for key in list(spec.keys):
        spec.delete(key)
    body = spec.worldbody.add_body(name="probe", mocap=True)
    body.add_geom(name="probe", size=[0.001, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    probe = model.geom("probe").id
    fixed = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0)
    still = [int(g) for g in fixed if g != probe]
    found = []
    for point in points:
        data.geom_xpos[probe] = point
        each = (mujoco.mj_geomDistance(model, data, probe, g, 5.0, None) for g in still)
        found.append(min(each) + 0.001)
    return np.array(found)


def _found(solids: Solids, points: np.ndarray) -> np.ndarray:
    return nearest(solids, torch.as_tensor(points[None], dtype=torch.float32)).distance[0].numpy()


@pytest.mark.parametrize("shape", SHAPES)
def test_distances_are_mujocos(shape: str) -> None:
    text = f'<geom {SHAPES[shape]} pos=".1 0 .2"/>'
    scene = load_scene(f"<mujoco><worldbody>{text}{FLEX}</worldbody></mujoco>")
    points = np.random.default_rng(0).uniform(-0.4, 0.6, (200, 3))
    found = _found(read_solids(scene.model), points)
    reference = _reference(scene.spec, points)
    assert (reference > 0.01).any() and (reference < -0.01).any()
    outside = reference > 0  # MuJoCo's own depths in rounded shapes stop short of the middle
    np.testing.assert_allclose(found[outside], reference[outside], atol=2e-5)
    assert ((found < 0) == ~outside).all()
    if shape in ("box", "ball", "plane"):
        np.testing.assert_allclose(found, reference, atol=2e-4)


@pytest.mark.parametrize("subtask", ["meshes", "unseen", "primitives"])
def test_objects_of_the_task_are_known_to_where_they_begin(subtask: str) -> None:
    scene = Drape().scene(subtask, 3)
    points = np.random.default_rng(0).uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 0.5], (200, 3))
    found, reference = _found(read_solids(scene.model), points), _reference(scene.spec, points)
    assert (found <= reference + 1e-5).all()  # beyond edges of hulls it is less
    np.testing.assert_array_equal(found < 0, reference < 0)
    inside = reference < 0
    assert inside.any()
    np.testing.assert_allclose(found[inside], reference[inside], atol=2e-4)
    beside = ~inside & (reference < 0.02)
    assert np.median(np.abs(found - reference)[beside]) < 1e-6


@pytest.mark.parametrize("shape", SHAPES)
def test_normals_are_gradients_of_distance(shape: str) -> None:
    solids = read_solids(_scene(f'<geom {SHAPES[shape]} pos=".1 0 .2"/>'))
    rows = np.random.default_rng(1).uniform(-0.4, 0.6, (1, 100, 3))
    points = torch.tensor(rows, dtype=torch.float32, requires_grad=True)
    near = nearest(solids, points)
    (slope,) = torch.autograd.grad(near.distance.sum(), points)
    np.testing.assert_allclose(near.normal.detach(), slope, atol=1e-4)
    np.testing.assert_allclose(near.normal.detach().norm(dim=-1), 1.0, atol=1e-4)


def test_scenes_with_less_are_padded_with_nothing() -> None:
    scenes = [Drape().scene(name, 4).model for name in ("primitives", "meshes", "unseen")]
    solids = [read_solids(model) for model in scenes]
    points = np.random.default_rng(0).uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 0.5], (100, 3))
    batch = torch.as_tensor(points, dtype=torch.float32).expand(3, -1, -1)
    together = nearest(joined(solids), batch)
    for k, one in enumerate(solids):
        np.testing.assert_allclose(together.distance[k], _found(one, points), atol=1e-6)


def test_a_scene_with_nothing_has_nothing_near() -> None:
    near = nearest(read_solids(_scene("")), torch.zeros(2, 5, 3)[:1])
    assert (near.distance >= 1e3).all() and (near.normal[..., 2] == 1).all()


def test_what_has_no_distance_is_refused_by_name() -> None:
    model = _scene('<geom name="egg" type="ellipsoid" size=".1 .2 .3"/>')
    with pytest.raises(UnsupportedSceneError, match="ellipsoid") as caught:
        read_solids(model, "egg.xml")
    assert "egg" in str(caught.value)
