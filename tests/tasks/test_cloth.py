"""A flex's vertices, the strain of its edges, and how deep it is in what stands there."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.errors import InputError
from orbisim.tasks.cloth import Probe, coordinates, edge_strain, vertices
from orbisim.tasks.drape import Drape


def test_vertices_are_where_mujoco_has_them() -> None:
    model = Drape().scene().model
    qpos = model.qpos0 + np.random.default_rng(0).normal(size=model.nq)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    places = vertices(model, qpos)
    np.testing.assert_allclose(places, data.flexvert_xpos, atol=1e-12)
    np.testing.assert_allclose(coordinates(model, places), qpos, atol=1e-12)


def test_strain_of_a_cloth_that_is_stretched() -> None:
    model = Drape().scene().model
    flat = vertices(model, np.array(model.qpos0))
    np.testing.assert_allclose(edge_strain(model, flat), 0.0, atol=1e-12)
    np.testing.assert_allclose(edge_strain(model, 1.1 * flat), 0.1, atol=1e-12)


def test_depth_in_a_ball_and_in_the_floor() -> None:
    scene = Drape().scene()
    radius = float(scene.model.flex_radius[0])
    points = np.array([[0.0, 0.0, 0.29], [0.0, 0.0, 0.5], [1.0, 0.0, 0.001]])
    depth = Probe(scene.spec).depth(points)
    np.testing.assert_allclose(depth, [0.01 + radius, 0.0, radius - 0.001], atol=1e-9)


def test_a_scene_without_a_flex() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(InputError, match="one flex of free vertices"):
        vertices(model, np.zeros(0))
