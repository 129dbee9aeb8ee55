"""Objects that stand on a floor."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.tasks import assets, standing

KINDS = {**standing.PRIMITIVES, **standing.MESHES, **standing.UNSEEN}


@pytest.mark.parametrize("kind", KINDS)
def test_each_stands_on_the_floor(kind: str) -> None:
    spec = assets.spec("drape")
    spec.delete(spec.geom("ball"))
    rng = np.random.default_rng(3)
    standing.add(spec, "objects", kind, KINDS[kind](rng, 1.0), (0.3, -0.2), 0.7)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geoms = np.flatnonzero(model.geom_bodyid == model.body("objects").id)
    plane = model.geom("floor").id
    gaps = [mujoco.mj_geomDistance(model, data, int(g), plane, 1.0, None) for g in geoms]
    assert min(gaps) == pytest.approx(0.0, abs=1e-6)
    assert np.abs(data.geom_xpos[geoms, :2].mean(axis=0) - [0.3, -0.2]).max() < 0.1
