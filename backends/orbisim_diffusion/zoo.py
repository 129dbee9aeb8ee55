"""The checkpoints that come with the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from orbisim_world_model.plain import checked

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import Scene
from orbisim_diffusion.checkpoint import MANIFEST, read_manifest
from orbisim_diffusion.scope import Scope, scene_problem

FOLDER = Path(__file__).parent / "zoo"


def find(scene: Scene, rows: npt.NDArray[np.float64]) -> Path:
    """The folder of the checkpoint that was trained on scenes like this one.

    Args:
      scene: the scene. rows: of its geoms (`orbisim.scene.visible.rows`).

    Raises:
      UnsupportedSceneError: there is none.
    """
    reasons = []
    for path in sorted(FOLDER.glob(f"*/{MANIFEST}")):
        manifest = read_manifest(path.parent)
        scope = checked(Scope, manifest.get("scope"), f"{path}: scope")
        reason = scene_problem(scope, rows)
        if not reason:
            return path.parent
        reasons.append(f"{path.parent.name}: {reason}")
    raise UnsupportedSceneError(
        scene.source,
        f"no vision checkpoint of the zoo shows it ({'; '.join(reasons) or 'there is none'})",
        remedy="train one (orbisim train vision) and name it, as in diffusion:PATH",
    )
