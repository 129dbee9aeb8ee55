"""`task:drape`: a cloth over what stands on a floor."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import make_backend
from orbisim.tasks.cloth import Probe, edge_strain, vertices
from orbisim.tasks.drape import Drape


def test_a_cloth_falls_and_lies_over_the_objects() -> None:
    task = Drape(objects=(2, 2))
    scene, arrays = task.scene("primitives", 3), task.episode("primitives", 3).arrays
    places = vertices(scene.model, arrays["qpos"])
    assert places.shape == (101, 225, 3)
    probe = Probe(scene.spec)
    assert probe.depth(places[0]).max() == 0.0
    assert np.quantile(probe.depth(places[-1]), 0.95) < 0.002
    assert np.sqrt(np.mean(edge_strain(scene.model, places[-1]) ** 2)) < 0.05
    assert places[0, :, 2].min() > 0.05 > places[-1, :, 2].min()
    assert places[-1, :, 2].max() > 0.1  # it hangs on something


@pytest.mark.parametrize("subtask", ["primitives", "meshes", "unseen"])
def test_objects_are_drawn_from_the_subtask(subtask: str) -> None:
    model = Drape().scene(subtask, 5).model
    names = {model.geom(g).name.rstrip("_0123456789") for g in range(1, model.ngeom)}
    known = {
        "primitives": {"ball", "box", "cone", "cylinder"},
        "meshes": {"lamp", "chair"},
        "unseen": {"stool", "pyramid"},
    }
    assert names and names <= known[subtask]


def test_trials_are_falls_over_the_same_objects() -> None:
    task = Drape()
    setup = task.trials(2, 5)
    np.testing.assert_array_equal(
        setup.initial.qpos[0], task.episode("primitives", 5).arrays["qpos"][0]
    )
    assert np.ptp(setup.initial.qpos, axis=0).max() > 0.01


def test_the_state_restores_a_cloth_exactly() -> None:
    scene = Drape().scene()
    engine = make_backend("mujoco", scene)
    state = engine.reset().replace(qpos=scene.model.key_qpos[:1].copy())
    middle = engine.step(state, np.zeros(0), 150)
    after = engine.step(middle, np.zeros(0), 50)
    np.testing.assert_array_equal(engine.step(middle, np.zeros(0), 50).qpos, after.qpos)
