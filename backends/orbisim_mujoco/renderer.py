"""MuJoCo's own renderer, off screen."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable
from typing import Any

import mujoco
import numpy.typing as npt

from orbisim.cameras import camera_number
from orbisim.errors import InputError, RenderingUnavailableError
from orbisim.host import gl
from orbisim.renderer import MODES, Mode, Renderer
from orbisim.scene import Scene
from orbisim.state import State

_MEMORY = ("mocap_pos", "mocap_quat", "eq_active", "userdata", "plugin_state")


class MujocoRenderer(Renderer):
    """Renders with `mujoco.Renderer` on EGL, OSMesa or GLFW, whichever the machine has.

    Args:
      scene_option: what to show (`mujoco.MjvOption`); None for MuJoCo's defaults.
    """

    name = "mujoco"
    modes = frozenset(MODES)

    def __init__(self, *, scene_option: mujoco.MjvOption | None = None) -> None:
        self._option = scene_option
        self._renderer: mujoco.Renderer | None = None
        self._size = (0, 0)

    def load(self, scene: Scene) -> None:
        """Prepares to render `scene`; the OpenGL context is made by the first image."""
        self.close()
        self._scene = scene
        self._data = mujoco.MjData(scene.model)

    def render(
        self,
        state: State,
        *,
        world: int = 0,
        camera: int | str | mujoco.MjvCamera = -1,
        height: int = 240,
        width: int = 320,
        mode: Mode = "rgb",
    ) -> npt.NDArray[Any]:
        """Renders one world (see `orbisim.renderer.Renderer.render`)."""
        self.check_mode(mode)
        if not 0 <= world < state.nworld:
            raise InputError(f"world {world} is not among the state's {state.nworld} worlds")
        renderer = self._renderer_of(height, width)
        self._place(state, world)
        _set_mode(renderer, mode)
        renderer.update_scene(self._data, self._camera(camera), self._option)
        image: npt.NDArray[Any] = renderer.render()
        return image.copy()

    def close(self) -> None:
        """Frees the OpenGL context."""
        if self._renderer is not None:
            self._free()
            self._renderer = None

    def _place(self, state: State, world: int) -> None:
        model, data = self._scene.model, self._data
        data.time = float(state.time[world])
        data.qpos[:] = state.qpos[world]
        data.qvel[:] = 0.0
        data.act[:] = state.act[world]
        for name in _MEMORY:
            if name in state.memory and getattr(data, name).size:
                getattr(data, name)[:] = state.memory[name][world]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        if model.nflex:
            mujoco.mj_flex(model, data)
        if model.ntendon:
            mujoco.mj_tendon(model, data)

    def _camera(self, camera: int | str | mujoco.MjvCamera) -> int | mujoco.MjvCamera:
        model = self._scene.model
        if isinstance(camera, mujoco.MjvCamera):
            return camera
        return camera_number(model, camera, self._scene.name)

    def _renderer_of(self, height: int, width: int) -> mujoco.Renderer:
        if self._renderer is None or self._size != (height, width):
            self.close()
            self._renderer = _new_renderer(self._scene.model, height, width)
            self._free = weakref.finalize(self, self._renderer.close)  # before the GL library goes
            self._size = (height, width)
        return self._renderer


def _set_mode(renderer: mujoco.Renderer, mode: Mode) -> None:
    renderer.disable_depth_rendering()
    renderer.disable_segmentation_rendering()
    if mode == "depth":
        renderer.enable_depth_rendering()
    elif mode == "segmentation":
        renderer.enable_segmentation_rendering()


def _new_renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    """A renderer with a frame buffer large enough for the image.

    Raises:
      RenderingUnavailableError: no OpenGL platform works here.
    """
    vis = model.vis.global_
    before = vis.offheight, vis.offwidth
    vis.offheight, vis.offwidth = max(before[0], height), max(before[1], width)
    try:
        return _on_any_platform(lambda: mujoco.Renderer(model, height, width))
    finally:
        vis.offheight, vis.offwidth = before


def _on_any_platform(make: Callable[[], mujoco.Renderer]) -> mujoco.Renderer:
    """Tries the platform that is set, then the others that this machine can load."""
    reason = "MUJOCO_GL=disable"
    if os.environ.get("MUJOCO_GL") != "disable":
        for platform in ("", *gl.available_platforms()):
            if platform:
                gl.use(platform)
            try:
                return make()
            except Exception as error:  # each platform raises an error type of its own
                reason = " ".join(str(error).split())[:200] or type(error).__name__
    raise RenderingUnavailableError(f"cannot make an OpenGL context ({reason}); {gl.INSTALL_HINT}")
