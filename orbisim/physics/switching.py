"""`Physics`: dm_control's `Physics` with backends and renderers that can be switched.

This is the one place that knows dm_control. With the backend `mujoco` everything is dm_control's
own code. With any other, each step hands the state held in MjData to the backend and mirrors the
result back: positions and velocities are set and MuJoCo's position and velocity stages are run on
them; fields of the acceleration stage come from the backend, or are NaN where it does not know
them, so that nothing reads another engine's numbers by mistake.
"""

from __future__ import annotations

import contextlib
import os
import types
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Self, TypeVar

import mujoco
import numpy as np
import numpy.typing as npt
from dm_control.mujoco import engine, wrapper
from dm_control.rl import control as _control

from orbisim.backend import Backend
from orbisim.errors import DivergedError, InputError, RenderingUnavailableError
from orbisim.host import gl
from orbisim.physics.mirror import Mirror
from orbisim.physics.mjdata import read_state, write_state
from orbisim.registry import backend_class, make_backend, make_renderer
from orbisim.renderer import Renderer
from orbisim.scene import Scene, SceneSource, load_scene
from orbisim.scene.objects import text_of
from orbisim.scene.scene import model_bytes
from orbisim.scene.texts import acts_between_timesteps
from orbisim.state import State

_NATIVE = "mujoco"
P = TypeVar("P")


class PhysicsDivergedError(DivergedError, _control.PhysicsError):
    """A backend diverged inside `Physics.step`; dm_control's environments know it as theirs."""


class _Switchable:
    """What OrbiSim adds to a dm_control `Physics`; mixed in front of it."""

    _mirror: Mirror | None = None
    _backend_name: str = _NATIVE
    _renderer: Renderer | None = None
    _renderer_name: str = _NATIVE
    _shown: Mapping[str, Any] = types.MappingProxyType({})
    _scene: Scene | None = None
    if TYPE_CHECKING:  # of dm_control's Physics
        model: Any
        data: Any
        _data: Any
        _warnings: Any

    # -- switching -----------------------------------------------------------------------------

    @property
    def backend(self) -> str:
        """Name of the backend in use."""
        return self._backend_name

    @property
    def renderer(self) -> str:
        """Name of the renderer in use."""
        return self._renderer_name

    def use_backend(self, backend: str | Backend, *, verify: bool = True, **config: Any) -> None:
        """Steps with another backend from now on; the physical state stays exactly as it is.

        Args:
          backend: a registered name, or a backend object.
          verify: whether to compare the first steps of a classical engine with C MuJoCo's from the
            same states, at each reset. One that stands still raises `EngineError` from `step`,
            one that moves otherwise warns (`EngineWarning`).
          **config: passed to the backend's class when it is given by name.

        Raises:
          UnknownNameError: no backend has this name.
          UnsupportedSceneError: the backend cannot simulate this scene. The backend in use stays.
        """
        self._forward_native_if_mirrored()
        if _is_native(backend) and not acts_between_timesteps(self.model.ptr):
            self._mirror, self._backend_name = None, _NATIVE
            return
        scene = self._current_scene()
        if isinstance(backend, Backend):
            backend.load(scene)
        else:
            backend = make_backend(backend, scene, **config)
        self._backend_name = backend.name
        self._mirror = Mirror(backend, self, verify=verify)

    def use_renderer(self, renderer: str | Renderer, **config: Any) -> None:
        """Renders with another renderer from now on.

        Raises:
          UnknownNameError: no renderer has this name.
          RenderingUnavailableError: this machine cannot use it.
        """
        self._shown = {}
        if renderer == _NATIVE:
            self._renderer, self._renderer_name = None, _NATIVE
            return
        if isinstance(renderer, Renderer):
            renderer.load(self._current_scene())
        else:
            renderer = make_renderer(renderer, self._current_scene(), **config)
        self._renderer, self._renderer_name = renderer, renderer.name

    @property
    def scene(self) -> Scene:
        """The scene, with the model as it is now (tasks may have changed it)."""
        return self._current_scene()

    def snapshot(self) -> State:
        """The state as a value, with one world, memory of backend and renderer included."""
        state = read_state(self.data.ptr) if self._mirror is None else self._mirror.state()
        return state.with_memory(**self._shown) if self._shown else state

    def restore(self, state: State) -> None:
        """Puts a state taken by `snapshot` back; what follows is what followed then.

        Raises:
          InputError: the state does not have exactly one world.
        """
        if state.nworld != 1:
            raise InputError(f"Physics holds one world; got a state of {state.nworld}")
        write_state(self.data.ptr, state)
        self._shown = self._shown_in(state)
        if self._mirror is not None:
            self._mirror.restore(state)
            return
        self.forward()
        write_state(self.data.ptr, state)  # `forward` moves the warm start

    # -- dm_control's interface ----------------------------------------------------------------

    def step(self, nstep: int = 1) -> None:
        """Advances by `nstep` timesteps of the model.

        Raises:
          PhysicsError: the state became invalid (dm_control's exception; with a backend other than
            C MuJoCo it is also a `DivergedError`).
        """
        if self._mirror is None:
            super().step(nstep)  # type: ignore[misc]
            return
        try:
            self._mirror.step(nstep)
        except DivergedError as error:
            raise PhysicsDivergedError(str(error), error.worlds) from error

    def check_invalid_state(self) -> contextlib.AbstractContextManager[None]:
        """Checks on leaving whether MuJoCo has warned (see dm_control), in a fifth of the time."""
        return _Warnings(self._warnings, super().check_invalid_state)  # type: ignore[misc]

    def forward(self) -> None:
        """Recomputes derived fields without advancing."""
        if self._mirror is None:
            super().forward()  # type: ignore[misc]
        else:
            self._mirror.forward()

    def render(
        self,
        height: int = 240,
        width: int = 320,
        camera_id: int | str = -1,
        overlays: Any = (),
        depth: bool = False,
        segmentation: bool = False,
        **options: Any,
    ) -> npt.NDArray[Any]:
        """Returns a camera view (see `dm_control.mujoco.Physics.render`).

        A renderer other than `mujoco` knows neither overlays nor options.

        Raises:
          RenderingUnavailableError: this machine cannot render.
          InputError: the renderer in use cannot do what is asked for.
        """
        if self._renderer is None:
            with _rendering_errors():
                image: npt.NDArray[Any] = super().render(  # type: ignore[misc]
                    height, width, camera_id, overlays, depth, segmentation, **options
                )
            return image
        asked = [name for name, value in {"overlays": overlays, **options}.items() if value]
        if asked:
            raise InputError(
                f"renderer {self._renderer_name!r} does not support {', '.join(asked)}"
            )
        mode: Any = "depth" if depth else "segmentation" if segmentation else "rgb"
        images, shown = self._renderer.observe(
            self.snapshot(), camera=camera_id, height=height, width=width, mode=mode
        )
        self._shown = dict(shown)
        return np.asarray(images[0])

    def copy(self, share_model: bool = False) -> Self:
        """A copy with the same backend and renderer."""
        new: Self = super().copy(share_model=share_model)  # type: ignore[misc]
        new._scene = self._scene
        new._adopt_switches(self)
        return new

    # -- inner workings ------------------------------------------------------------------------

    def _shown_in(self, state: State) -> Mapping[str, Any]:
        """What the renderer in use remembers in a state."""
        names = self._renderer.memory if self._renderer is not None else ()
        return {name: state.memory[name] for name in names if name in state.memory}

    def _adopt_switches(self, other: _Switchable) -> None:
        if other._mirror is not None:
            self._backend_name = other._backend_name
            self._mirror = other._mirror.copy_for(self)
        self._renderer, self._renderer_name = other._renderer, other._renderer_name
        self._shown = other._shown

    def _reload_from_data(self, data: Any) -> None:
        backend = self._mirror.backend if self._mirror is not None else None
        self._mirror = None  # it mirrors into the old data
        if getattr(self, "_data", None) is not None and data.model is not self._data.model:
            self._scene = None  # another model: dm_control's reload_from_...
        super()._reload_from_data(data)  # type: ignore[misc]
        if backend is not None:
            self.use_backend(backend)
        elif acts_between_timesteps(self.model.ptr):
            self.use_backend(_NATIVE)
        if self._renderer is not None:
            self._renderer.load(self._current_scene())

    def _forward_native_if_mirrored(self) -> None:
        """Leaves MjData as C MuJoCo would have it, before another backend takes over."""
        if self._mirror is not None:
            self._mirror.leave()

    def _current_scene(self) -> Scene:
        model = self.model.ptr
        if self._scene is None:
            return Scene.from_model(model)
        return self._scene if self._scene_is_current(model) else self._scene.with_model(model)

    def _scene_is_current(self, model: mujoco.MjModel) -> bool:
        assert self._scene is not None
        return model_bytes(model) == model_bytes(self._scene.model)

    def __reduce__(self) -> tuple[Any, ...]:
        base = _base_of(type(self))
        switches = {"renderer": self._renderer_name, "backend": self._backend_name}
        return (_unpickle, (base, type(self) is Physics, self.data, switches))


class _Warnings:
    """Notices that MuJoCo's warnings have changed, and leaves it to dm_control to say so."""

    __slots__ = ("_before", "_check", "_counts")

    def __init__(self, counts: npt.NDArray[np.int32], check: Callable[[], Any]) -> None:
        self._counts, self._check = counts, check

    def __enter__(self) -> None:
        self._before = self._counts.tobytes()

    def __exit__(self, kind: Any, *_: object) -> None:
        if kind is not None or self._counts.tobytes() == self._before:
            return
        after = self._counts.copy()
        self._counts[:] = np.frombuffer(self._before, self._counts.dtype)
        with self._check():
            self._counts[:] = after


class Physics(_Switchable, engine.Physics):
    """A `dm_control.mujoco.Physics` whose backend and renderer can be switched at any time.

    ```python
    physics = orbisim.Physics.from_xml_path("scene.xml")
    physics.step()
    physics.use_backend("warp")
    physics.step()
    ```
    """

    @classmethod
    def from_scene(
        cls,
        scene: SceneSource,
        *,
        backend: str | Backend = _NATIVE,
        renderer: str | Renderer = _NATIVE,
    ) -> Self:
        """Makes a `Physics` from a scene, or anything that `load_scene` makes one of.

        The scene itself stays as it is.
        """
        scene = load_scene(scene)
        physics = cls.from_model(_copied_model(scene.model))
        physics._scene = scene
        physics.use_backend(backend)
        physics.use_renderer(renderer)
        return physics

    @classmethod
    def from_xml_path(
        cls,
        file_path: str | os.PathLike[str],
        *,
        backend: str | Backend = _NATIVE,
        renderer: str | Renderer = _NATIVE,
    ) -> Self:
        """Makes a `Physics` from any scene that `orbisim.load_scene` reads.

        Raises:
          SceneError: the file cannot be read.
        """
        return cls.from_scene(load_scene(file_path), backend=backend, renderer=renderer)

    @classmethod
    def from_xml_string(
        cls,
        xml_string: str | bytes,
        assets: Mapping[str, bytes | str] | None = None,
        *,
        backend: str | Backend = _NATIVE,
        renderer: str | Renderer = _NATIVE,
    ) -> Self:
        """Makes a `Physics` from MJCF or URDF given as text or bytes.

        Raises:
          SceneError: the document cannot be read.
          InputError: it is no document.
        """
        text = text_of(xml_string).lstrip("\ufeff")
        if not text.lstrip().startswith("<"):
            raise InputError(
                f"an XML document starts with '<'; got {text[:60]!r} (from_xml_path takes a path)"
            )
        scene = load_scene(text, assets=assets)
        return cls.from_scene(scene, backend=backend, renderer=renderer)


def hybrid(cls: type[P]) -> type[P]:
    """The class with `use_backend` and `use_renderer` added to it.

    For tasks with a `Physics` of their own: `physics = hybrid(MyPhysics).from_xml_path(...)`.
    """
    if issubclass(cls, _Switchable):
        return cls
    if not issubclass(cls, engine.Physics):
        raise InputError(f"expected a subclass of dm_control.mujoco.Physics; got {cls!r}")
    if cls not in _hybrids:
        namespace: dict[str, Any] = {"__doc__": cls.__doc__, "__module__": cls.__module__}
        owner = next(base for base in cls.__mro__ if "check_invalid_state" in vars(base))
        if owner is not engine.Physics:  # the class has a check of its own
            namespace["check_invalid_state"] = vars(owner)["check_invalid_state"]
        _hybrids[cls] = type(cls.__name__, (_Switchable, cls), namespace)
    return _hybrids[cls]


_hybrids: dict[type, Any] = {}


def adopt(physics: P, *, scene: Scene | None = None) -> P:
    """Gives an existing dm_control `Physics` object `use_backend` and `use_renderer`, in place.

    Args:
      scene: the scene that it was made from, if known.
    """
    switchable: Any = physics
    switchable.__class__ = hybrid(type(physics))
    if scene is not None:
        switchable._scene = scene
    return physics


# ---------------------------------------------------------------------------------------------


def _is_native(backend: str | Backend) -> bool:
    if isinstance(backend, Backend):
        return type(backend) is backend_class(_NATIVE)
    return backend == _NATIVE


def _copied_model(model: mujoco.MjModel) -> Any:
    import copy

    return wrapper.MjModel(copy.copy(model))


@contextlib.contextmanager
def _rendering_errors() -> Iterator[None]:
    """Turns dm_control's failure to make an OpenGL context into a message that helps."""
    try:
        yield
    except (RuntimeError, ImportError, AttributeError) as error:
        text = str(error)
        if any(word in text for word in ("OpenGL", "EGL", "GLFW", "OSMesa", "rendering backend")):
            raise RenderingUnavailableError(f"{text.splitlines()[0]}; {gl.INSTALL_HINT}") from error
        raise


def _base_of(cls: type) -> type:
    """The class that `hybrid` was given, for pickling."""
    if "_Switchable" in (base.__name__ for base in cls.__bases__):
        return cls.__bases__[1]
    return cls


def _unpickle(base: type, plain: bool, data: Any, switches: dict[str, str]) -> Any:
    cls: Any = Physics if plain else hybrid(base)
    physics = cls.__new__(cls)
    physics.__setstate__(data)
    physics.use_backend(switches["backend"])
    physics.use_renderer(switches["renderer"])
    return physics
