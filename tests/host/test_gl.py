"""MUJOCO_GL is set to what the machine has, and only where the default would fail."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from orbisim.host import gl

VARIABLES = ("MUJOCO_GL", "PYOPENGL_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")


@pytest.fixture(autouse=True)
def headless(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """A Linux machine without a display, where neither MuJoCo nor dm_control is imported yet."""
    for name in VARIABLES:
        monkeypatch.setenv(name, "")  # so that what `use` sets is undone, too
        monkeypatch.delenv(name)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(gl, "_READ_AT_IMPORT", ())
    return monkeypatch


@pytest.mark.parametrize(
    ("platforms", "chosen"), [(("egl", "osmesa"), "egl"), (("osmesa",), "osmesa")]
)
def test_the_first_platform_there_is(
    headless: pytest.MonkeyPatch, platforms: tuple[str, ...], chosen: str
) -> None:
    headless.setattr(gl, "available_platforms", lambda: platforms)
    gl.configure()
    assert os.environ["MUJOCO_GL"] == os.environ["PYOPENGL_PLATFORM"] == chosen


def test_without_any_rendering_is_off(headless: pytest.MonkeyPatch) -> None:
    headless.setattr(gl, "available_platforms", lambda: ())
    gl.configure()
    assert os.environ["MUJOCO_GL"] == "disable"


@pytest.mark.parametrize("name", ["DISPLAY", "WAYLAND_DISPLAY"])
def test_a_display_is_left_to_glfw(headless: pytest.MonkeyPatch, name: str) -> None:
    headless.setenv(name, ":0")
    gl.configure()
    assert "MUJOCO_GL" not in os.environ


def test_the_users_choice_stays(headless: pytest.MonkeyPatch) -> None:
    headless.setenv("MUJOCO_GL", "glfw")
    gl.configure()
    assert os.environ["MUJOCO_GL"] == "glfw"


def test_other_systems_have_a_default_that_works(headless: pytest.MonkeyPatch) -> None:
    headless.setattr(sys, "platform", "darwin")
    gl.configure()
    assert "MUJOCO_GL" not in os.environ


def test_libraries_that_cannot_be_loaded_are_no_platforms(headless: pytest.MonkeyPatch) -> None:
    headless.setattr(gl, "_LIBRARIES", {"egl": "libNoSuch.so.1", "osmesa": "libc.so.6"})
    assert tuple(gl._loadable()) == ("osmesa",)


def test_tritons_compiler_is_loaded_before_mesas(
    headless: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    order: list[str] = []
    (tmp_path / "triton" / "_C").mkdir(parents=True)
    (tmp_path / "triton" / "__init__.py").touch()
    (tmp_path / "triton" / "_C" / "libtriton.so").touch()
    headless.syspath_prepend(tmp_path)
    headless.setattr(gl.ctypes, "CDLL", lambda name: order.append(Path(name).name))
    gl.available_platforms.cache_clear()
    gl.configure()
    gl.available_platforms.cache_clear()
    assert order == ["libtriton.so", "libEGL.so.1", "libOSMesa.so.8"]
