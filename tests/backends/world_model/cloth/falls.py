"""Falls of the small cloth of the conformance tests, simulated by MuJoCo."""

from __future__ import annotations

import functools

import numpy as np
import torch
from orbisim_world_model.cloth.config import ClothConfig, cloth_preset
from orbisim_world_model.cloth.data import Falls
from orbisim_world_model.cloth.mesh import read_mesh
from orbisim_world_model.cloth.solids import joined, read_solids

from orbisim import load_scene, make_backend
from orbisim.testing import scenes

STEP = 0.02


@functools.cache
def falls(episodes: int = 4, steps: int = 20) -> Falls:
    """Episodes that begin with different velocities."""
    scene = load_scene(scenes.CLOTH)
    mesh = read_mesh(scene.model, STEP)
    engine = make_backend("mujoco", scene, nworld=episodes)
    state = engine.reset()
    speeds = 0.2 * np.random.default_rng(0).standard_normal((episodes, 1, 3))
    qvel = np.zeros_like(state.qvel)
    qvel[:, mesh.dof.numpy()] = speeds
    state = state.replace(qvel=qvel)
    controls = np.zeros((episodes, steps, 0))
    found = engine.rollout(state, controls, nstep=round(STEP / scene.model.opt.timestep))
    rows = (torch.as_tensor(found.with_initial(n), dtype=torch.float32) for n in ("qpos", "qvel"))
    notes = {"groups": ["ball"], "sources": [{"task": scene.source, "episodes": episodes}]}
    solids = joined([read_solids(scene.model)] * episodes)
    return Falls(mesh, mesh.split(*rows), solids, torch.zeros(episodes, dtype=torch.long), notes)


def toy_cloth(name: str = "cloth", **settings: str) -> ClothConfig:
    """A configuration that trains in seconds."""
    small = {"model.width": "16", "model.layers": "2", "train.stages": "1x2x4"}
    small |= {"model.codes": "8"} if name == "cloth_shape" else {}
    return cloth_preset(name, small | {k.replace("__", "."): v for k, v in settings.items()})
