"""MuJoCo's compiler, for what the reader has to know before the scene is whole."""

from __future__ import annotations

import warnings

import mujoco

from orbisim.files.guard import COMPILING
from orbisim.host.engine_log import engine_warnings, ignore
from orbisim.scene.mjcf import COMPILER_ERRORS, as_scene_error


def compiled(spec: mujoco.MjSpec, source: str) -> mujoco.MjModel:
    """The compiled model; the spec can be changed further.

    Raises:
      SceneError: MuJoCo cannot compile it.
    """
    with COMPILING, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `Scene` collects them when the scene is whole
        try:
            with engine_warnings(ignore):
                return spec.copy().compile()
        except COMPILER_ERRORS as error:
            raise as_scene_error(error, source) from None
