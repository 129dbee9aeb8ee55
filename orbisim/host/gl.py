"""Chooses an OpenGL platform before MuJoCo or dm_control do.

Both read the environment variable MUJOCO_GL when they are imported, and fall back to GLFW, which
needs a display. `configure` sets the variable to what the machine has, unless the user did.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from pathlib import Path

INSTALL_HINT = (
    "install EGL or OSMesa (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri libosmesa6), "
    "or use the renderer 'null'"
)

_READ_AT_IMPORT = ("mujoco.rendering.classic.gl_context", "dm_control._render")
_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}


def configure() -> None:
    """Sets MUJOCO_GL if the user did not and the default would fail."""
    _load_triton_first()
    if os.environ.get("MUJOCO_GL") or not sys.platform.startswith("linux"):
        return
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return
    platforms = available_platforms()
    if platforms:
        use(platforms[0])
    else:
        os.environ["MUJOCO_GL"] = "disable"


def _load_triton_first() -> None:
    """Loads Triton's compiler, which comes with PyTorch for CUDA, before Mesa's.

    Both carry LLVM. Loaded after Mesa's (by dm_control under EGL, for one) Triton's ends the
    process with a segmentation fault; the other way round both work.
    """
    spec = importlib.util.find_spec("triton")
    if spec is None or spec.origin is None or not sys.platform.startswith("linux"):
        return
    for library in Path(spec.origin).parent.glob("_C/libtriton*.so"):
        with contextlib.suppress(OSError):  # a damaged PyTorch is told of where it is used
            ctypes.CDLL(str(library))


def use(platform: str) -> None:
    """Makes MuJoCo and dm_control use `egl` or `osmesa` from now on, also if already imported."""
    os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = platform
    for name in _READ_AT_IMPORT:
        if name in sys.modules:
            importlib.reload(sys.modules[name])


@functools.cache
def available_platforms() -> tuple[str, ...]:
    """Of `egl` and `osmesa`, those whose library this machine can load."""
    return tuple(_loadable())


def _loadable() -> Iterator[str]:
    for platform, library in _LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        yield platform
