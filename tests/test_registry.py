"""Backends and renderers by name: registered, constructed with an argument, refused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from orbisim import registry
from orbisim.backend import Backend
from orbisim.errors import InputError, UnknownNameError
from orbisim.renderer import NullRenderer, Renderer
from orbisim.scene import Scene, load_scene
from orbisim.state import State
from orbisim.testing import scenes


class Still(Backend):
    """A backend in which nothing moves."""

    name = "still"

    def __init__(self, *, gain: float = 1.0, **options: Any) -> None:
        if gain < 0:
            raise TypeError("a gain of the wrong kind")
        super().__init__(**options)
        self.gain = gain

    def load(self, scene: Scene) -> None:
        self._scene = scene

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        pytest.fail("what is registered is made, and nothing of it is reset")

    def step(self, state: State, control: Any = None, nstep: int = 1) -> State:
        return state


class Sketch(NullRenderer):
    """A renderer that takes an argument."""

    name = "sketch"

    def __init__(self, argument: str = "") -> None:
        self.argument = argument


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(registry, "_registered", {registry.BACKENDS: {}, registry.RENDERERS: {}})
    registry.register_backend("still", Still)
    registry.register_renderer("sketch", Sketch)
    yield


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(scenes.PENDULUM)


def test_what_is_registered_is_listed_beside_the_installed() -> None:
    assert set(registry.available_backends()) >= {"mujoco", "still"}
    assert list(registry.available_backends()) == sorted(registry.available_backends())
    assert set(registry.available_renderers()) >= {"mujoco", "null", "sketch"}
    assert registry.backend_class("still") is Still
    assert registry.renderer_class("null") is NullRenderer


def test_what_is_registered_comes_before_what_is_installed() -> None:
    registry.register_renderer("null", Sketch)
    assert registry.renderer_class("null") is Sketch
    assert registry.available_renderers().count("null") == 1


def test_backends_are_made_with_their_options_and_the_scene(scene: Scene) -> None:
    backend = registry.make_backend("still", scene, nworld=3, device="cpu", gain=2.0)
    assert isinstance(backend, Still)
    assert (backend.nworld, backend.device, backend.gain) == (3, "cpu", 2.0)
    assert backend.scene is scene


def test_an_argument_stands_behind_a_colon(scene: Scene) -> None:
    renderer = registry.make_renderer("sketch:with:colons", scene)
    assert isinstance(renderer, Sketch)
    assert renderer.argument == "with:colons"


def test_an_argument_that_nobody_takes(scene: Scene) -> None:
    with pytest.raises(InputError, match="'still' takes no argument; got still:path"):
        registry.make_backend("still:path", scene)


def test_options_that_nobody_takes(scene: Scene) -> None:
    with pytest.raises(InputError, match=r"'still': .*unexpected keyword argument 'gian'"):
        registry.make_backend("still", scene, gian=1.0)


def test_a_plugins_own_type_errors_come_through(scene: Scene) -> None:
    with pytest.raises(TypeError, match="wrong kind"):
        registry.make_backend("still", scene, gain=-1.0)


@pytest.mark.parametrize("name", ["", "a:b"])
def test_names_that_could_not_be_asked_for(name: str) -> None:
    with pytest.raises(InputError, match="not empty and has no colon"):
        registry.register_backend(name, Still)


@pytest.mark.parametrize("kind", [NullRenderer, "still", Still(), None])
def test_only_backends_are_backends(kind: Any) -> None:
    with pytest.raises(InputError, match="must be a subclass of Backend"):
        registry.register_backend("odd", kind)


def test_unknown_names(scene: Scene) -> None:
    with pytest.raises(UnknownNameError, match="unknown backend 'stil'; did you mean 'still'"):
        registry.make_backend("stil", scene)
    with pytest.raises(UnknownNameError, match="unknown renderer 'still'"):
        registry.renderer_class("still")
    assert issubclass(registry.renderer_class("sketch"), Renderer)
