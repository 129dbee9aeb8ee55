"""USD: public assets, where `tools/corpus_usd.py` has fetched them."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene import load_scene

pytestmark = pytest.mark.slow

CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "orbisim" / "corpus"
ASSETS = sorted((CACHE / "unpacked" / "newton" / "newton").rglob("*.usd*"))
WITHOUT_PHYSICS = ("bear", "bunny", "crazyflie", "curvedSurface", "mpm_", "rj45", "unisex_shirt",
                   "deformables", "tetmesh")  # fmt: skip


@pytest.mark.skipif(not ASSETS, reason="run tools/corpus_usd.py first")
@pytest.mark.parametrize("path", ASSETS, ids=lambda path: path.stem)
def test_newtons_assets(path: Path) -> None:
    """Each loads and runs, or is refused because there is nothing to simulate."""
    if path.name.startswith(WITHOUT_PHYSICS):
        with pytest.raises(SceneError, match="holds no physics"):
            load_scene(path)
        return
    model = load_scene(path).model
    data = mujoco.MjData(model)
    for _ in range(10):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all()
