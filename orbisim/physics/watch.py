"""Notices that a task has changed the model."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np


class ModelWatch:
    """Notices when a model's numbers change.

    Looks at every option and every array that enters the dynamics; meshes, textures and skins do
    not change at run time. That actuation is disabled is no change of the scene: dm_control does so
    for the moment of a `forward`.
    """

    _SKIPPED = (
        "mesh_",
        "tex_",
        "skin_",
        "bvh_",
        "names",
        "paths",
        "text_",
        "tuple_",
        "key_",
        "oct_",
    )

    def __init__(self, model: mujoco.MjModel) -> None:
        self._option = model.opt
        options, self._arrays = _numbers(model.opt), []
        self._scalars = [name for name, value in options.items() if np.isscalar(value)]
        for name, value in (options | _numbers(model)).items():
            has_numbers = isinstance(value, np.ndarray) and value.size
            if has_numbers and not name.startswith(self._SKIPPED):
                self._arrays.append(value)
        self._last = self._snapshot()

    def changed(self) -> bool:
        """Whether anything changed since the last call."""
        snapshot = self._snapshot()
        if snapshot == self._last:
            return False
        self._last = snapshot
        return True

    def _snapshot(self) -> bytes:
        scalars = {name: getattr(self._option, name) for name in self._scalars}
        scalars["disableflags"] &= ~int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        return repr(scalars).encode() + b"".join(array.tobytes() for array in self._arrays)


def _numbers(part: Any) -> dict[str, Any]:
    """The public fields of a part of MuJoCo's model; arrays are views of its memory."""
    return {name: getattr(part, name) for name in dir(part) if not name.startswith("_")}
