"""The zoo's cloth on objects that it was not trained on, beside what is known without learning."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch
from orbisim_world_model.cloth.dynamics import rolled
from orbisim_world_model.cloth.evaluate import baseline
from orbisim_world_model.cloth.mesh import Cloth, read_mesh
from orbisim_world_model.cloth.solids import read_solids

from orbisim import make_backend
from orbisim.tasks.cloth import edge_strain, vertices
from orbisim.tasks.drape import Drape

STEPS = 100


@pytest.mark.slow
def test_falls_over_unseen_objects_are_predicted_better_than_known() -> None:
    task, far = Drape(), []
    for seed in (1_000_000, 1_000_001, 1_000_002):
        setup = task.trials(2, seed, "unseen")
        model, nothing = setup.scene.model, np.zeros((2, STEPS, 0))
        paths = {}
        for name, nstep in (("mujoco", 10), ("learned", 1)):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an edge may be stretched further than in training
                engine = make_backend(name, setup.scene, nworld=2)
                qpos = np.asarray(engine.rollout(setup.initial, nothing, nstep=nstep).qpos)
            paths[name] = vertices(model, qpos)
        mesh = read_mesh(model, task.control_timestep)
        start = Cloth(
            torch.as_tensor(vertices(model, setup.initial.qpos), dtype=torch.float32),
            torch.zeros(2, mesh.vertices, 3),
        )
        with torch.no_grad():
            known = rolled(baseline("known", mesh), start, read_solids(model).expand(2), STEPS)
        paths["known"] = known.pos.transpose(0, 1).double().numpy()
        ends = {name: np.linalg.norm(path - paths["mujoco"], axis=-1)[:, -1].mean()
                for name, path in paths.items()}  # fmt: skip
        far.append((ends["learned"], ends["known"]))
        assert np.median(np.abs(edge_strain(model, paths["learned"]))) < 0.02
    learned, known_error = np.mean(far, axis=0)
    assert learned < 0.7 * known_error
