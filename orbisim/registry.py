"""Backends and renderers by name: plug-ins (see `orbisim.plugins`), or registered for a process.

A name may carry an argument after a colon (`learned:path/to/checkpoint`); it is passed to the
class as `argument=`.
"""

from __future__ import annotations

from typing import Any

from orbisim import plugins
from orbisim.backend import Backend
from orbisim.errors import InputError, UnknownNameError
from orbisim.renderer import Renderer
from orbisim.scene import SceneSource, load_scene

BACKENDS = "orbisim.backends"
RENDERERS = "orbisim.renderers"

_registered: dict[str, dict[str, type]] = {BACKENDS: {}, RENDERERS: {}}


def available_backends() -> tuple[str, ...]:
    """Names of the registered backends (their dependencies may still be missing)."""
    return tuple(sorted({*plugins.names(BACKENDS), *_registered[BACKENDS]}))


def available_renderers() -> tuple[str, ...]:
    """Names of the registered renderers."""
    return tuple(sorted({*plugins.names(RENDERERS), *_registered[RENDERERS]}))


def register_backend(name: str, cls: type[Backend]) -> None:
    """Registers a backend for this process, without an entry point."""
    _register(BACKENDS, name, cls, Backend)


def register_renderer(name: str, cls: type[Renderer]) -> None:
    """Registers a renderer for this process, without an entry point."""
    _register(RENDERERS, name, cls, Renderer)


def _register(group: str, name: str, cls: type, base: type) -> None:
    if not (isinstance(cls, type) and issubclass(cls, base)):
        raise InputError(f"{name!r} must be a subclass of {base.__name__}; got {cls!r}")
    if ":" in name or not name:
        raise InputError(f"a plug-in's name is not empty and has no colon; got {name!r}")
    _registered[group][name] = cls


def backend_class(name: str) -> type[Backend]:
    """The class registered under a name (without argument).

    Raises:
      UnknownNameError: there is none.
      MissingDependencyError: its packages are not installed.
    """
    return _find(BACKENDS, "backend", name)


def renderer_class(name: str) -> type[Renderer]:
    """The class registered under a name (without argument).

    Raises:
      UnknownNameError: there is none.
      MissingDependencyError: its packages are not installed.
    """
    return _find(RENDERERS, "renderer", name)


def _find(group: str, kind: str, name: str) -> Any:
    if name in _registered[group]:
        return _registered[group][name]
    known = {*plugins.names(group), *_registered[group]}
    if name not in known:
        raise UnknownNameError(kind, name, known)
    return plugins.load(group, name, kind)


def make_backend(
    name: str,
    scene: SceneSource,
    *,
    nworld: int = 1,
    device: str | None = None,
    **config: Any,
) -> Backend:
    """Makes a backend by name and loads a scene into it.

    Args:
      name: a registered name, with an optional argument after a colon.
      scene: the scene to simulate, or anything that `load_scene` makes one of.
      nworld: number of worlds to prepare for.
      device: where to compute.
      **config: passed to the backend's class.

    Raises:
      UnknownNameError: no backend has this name.
      MissingDependencyError: the backend's packages are not installed.
      UnsupportedSceneError: the backend cannot simulate the scene.
      SceneError: the scene cannot be read.
    """
    short, argument = _split(name, "backend")
    if argument:
        config["argument"] = argument
    cls = backend_class(short)
    backend = _construct(cls, "backend", short, nworld=nworld, device=device, **config)
    backend.load(load_scene(scene))
    return backend


def make_renderer(name: str, scene: SceneSource, **config: Any) -> Renderer:
    """Makes a renderer by name and loads a scene into it.

    Raises:
      UnknownNameError: no renderer has this name.
      RenderingUnavailableError: this machine cannot render.
      SceneError: the scene cannot be read.
    """
    short, argument = _split(name, "renderer")
    if argument:
        config["argument"] = argument
    renderer = _construct(renderer_class(short), "renderer", short, **config)
    renderer.load(load_scene(scene))
    return renderer


def _split(name: str, kind: str) -> tuple[str, str]:
    """A plug-in's name and its argument."""
    if not isinstance(name, str):
        raise InputError(f"a {kind} is named by a string; got {name!r}")
    short, _, argument = name.partition(":")
    return short, argument


def _construct(cls: type, kind: str, name: str, **config: Any) -> Any:
    try:
        return cls(**config)
    except TypeError as error:
        if "argument" in config and "argument" in str(error):
            raise InputError(
                f"{kind} {name!r} takes no argument; got {name}:{config['argument']}"
            ) from error
        if "unexpected keyword" in str(error):
            raise InputError(f"{kind} {name!r}: {error}") from error
        raise
