"""`orbisim doctor`: what works on this machine, one line each; what a bug report needs."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import importlib.util
import multiprocessing
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import click

from orbisim.cli.common import emit_json, json_option

PACKAGES = (
    "mujoco", "mujoco-warp", "warp-lang", "dm_control", "torch", "numpy", "scipy", "usd-core",
    "yourdfpy", "trimesh", "meshcat", "gymnasium", "h5py", "mcap", "rosbags", "ray",
)  # fmt: skip
"""Packages whose versions matter for what the project does."""

Status = Literal["ok", "absent", "failed"]


@dataclasses.dataclass(frozen=True)
class Check:
    """One line.

    Attributes:
      kind: of what was tried ("backend"). name: its name.
      status: `absent`: it is optional, and not installed or not there. text: what was found.
    """

    kind: str
    name: str
    status: Status
    text: str


@click.command("doctor", epilog="Example: orbisim doctor > doctor.txt")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=1),
    default=180.0,
    show_default=True,
    help="Seconds for each backend, renderer and reader.",
)
@json_option
def command(time_limit: float, as_json: bool) -> int:
    """Try what is installed, one line each: versions, OpenGL, GPU, backends, renderers, readers.

    Backends take a step, renderers draw an image, readers of scenes read a small document, each in
    a process of its own. The exit status is 1 if something that is installed does not work. Paste
    the output into a bug report.
    """
    checks = []
    for check in examine(time_limit):
        checks.append(check)
        if not as_json:
            click.echo(f"{check.kind:<9} {check.name:<14} {check.status:<8} {check.text}")
    failed = [one for one in checks if one.status == "failed"]
    if as_json:
        emit_json(
            {
                "schema": "orbisim.doctor/1",
                "failed": len(failed),
                "checks": [dataclasses.asdict(one) for one in checks],
            }
        )
    return 1 if failed else 0


def examine(time_limit: float = 180.0) -> Iterator[Check]:
    """All checks, as they are done.

    Args:
      time_limit: s, for each.
    """
    from orbisim import plugins
    from orbisim.recording.formats.registry import GROUP as LOGS
    from orbisim.registry import available_backends, available_renderers
    from orbisim.scene import readers

    yield from versions()
    with Bench(time_limit) as bench:
        chosen = os.environ.get("MUJOCO_GL") or "default"
        yield bench.attempt("opengl", chosen, _opengl)
        yield bench.attempt("gpu", "cuda", _gpu)
        for name in available_backends():
            yield bench.attempt("backend", name, _backend, name)
        for name in available_renderers():
            yield bench.attempt("renderer", name, _renderer, name)
        for suffix in readers.suffixes():
            yield bench.attempt("reader", suffix, _reader, suffix)
        for name in sorted(plugins.names(LOGS)):
            yield bench.attempt("log", name, _log, LOGS, name)


def versions() -> Iterator[Check]:
    """Of the system, Python, OrbiSim and the packages."""
    from orbisim.version import VERSION

    yield Check("system", platform.system(), "ok", platform.platform())
    yield Check("version", "python", "ok", f"{platform.python_version()} ({sys.executable})")
    yield Check("version", "orbisim", "ok", f"{VERSION} ({Path(__file__).parents[1]})")
    for name in PACKAGES:
        try:
            yield Check("version", name, "ok", metadata.version(name))
        except metadata.PackageNotFoundError:
            yield Check("version", name, "absent", "not installed")


class Bench:
    """Tries things in a process beside this one, and in a new one after a crash or a timeout.

    Args:
      time_limit: s, for each.
    """

    def __init__(self, time_limit: float = 180.0) -> None:
        self._limit = time_limit
        self._pool: concurrent.futures.ProcessPoolExecutor | None = None

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def attempt(self, kind: str, name: str, work: Callable[..., str], *arguments: Any) -> Check:
        """What comes of a function of a module, whose text is what was found."""
        started = time.perf_counter()
        if self._pool is None:
            self._pool = concurrent.futures.ProcessPoolExecutor(
                1, multiprocessing.get_context("spawn"), initializer=_silenced
            )
        try:
            status, text = self._pool.submit(tried, work, arguments).result(self._limit)
        except concurrent.futures.TimeoutError:
            self._end()
            return Check(kind, name, "failed", f"no result within {self._limit:g} s")
        except concurrent.futures.process.BrokenProcessPool:
            self._end()
            return Check(kind, name, "failed", "ended its process (a crash of a driver or library)")
        took = time.perf_counter() - started
        return Check(kind, name, status, text + (f" ({took:.1f} s)" if status == "ok" else ""))

    def _end(self) -> None:
        if self._pool is not None:
            for process in list((self._pool._processes or {}).values()):
                process.kill()
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


def _silenced() -> None:
    """Engines print to the descriptors themselves: nobody hears."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)


def tried(work: Callable[..., str], arguments: tuple[Any, ...]) -> tuple[Status, str]:
    """What comes of a function, in this process."""
    from orbisim.errors import MissingDependencyError

    try:
        return "ok", work(*arguments)
    except MissingDependencyError as error:
        return "absent", " ".join(str(error).split())
    except _NotThereError as error:
        return "absent", str(error)
    except BaseException as error:
        return "failed", " ".join(f"{type(error).__name__}: {error}".split())


class _NotThereError(Exception):
    """This machine does not have what was looked for, which is no fault."""


_TRIAL = """<mujoco model="trial"><worldbody><light pos="0 0 3"/><body pos="0 0 1">
<joint name="hinge" axis="0 1 0" damping="0.1"/><geom size="0.05 0.3" type="capsule" mass="1"/>
</body></worldbody><actuator><motor joint="hinge" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>"""
_FITTING = "suite:cartpole-swingup"
"""A scene that a checkpoint of the zoo fits, for backends that refuse others."""
_PUSHING = "task:push"
"""A scene that a checkpoint of the renderers fits."""


def _opengl() -> str:
    from orbisim.host.gl import available_platforms

    seen = _renderer("mujoco")
    there = ", ".join(available_platforms()) or "neither EGL nor OSMesa"
    return f"{seen}; libraries: {there}"


def _gpu() -> str:
    if importlib.util.find_spec("torch") is not None:
        import torch

        if torch.cuda.is_available():
            names = [
                torch.cuda.get_device_name(number) for number in range(torch.cuda.device_count())
            ]
            return f"{', '.join(names)} (CUDA {torch.version.cuda})"
        raise _NotThereError(f"torch {torch.__version__} finds none; --device cuda will not work")
    if importlib.util.find_spec("warp") is not None:
        import warp

        if devices := warp.get_cuda_devices():
            return ", ".join(device.name for device in devices)
        raise _NotThereError("warp finds none; --device cuda will not work")
    raise _NotThereError("neither torch nor warp is installed to look for one")


def _backend(name: str) -> str:
    import numpy as np

    from orbisim.registry import make_backend

    def stepped(scene: str) -> str:
        engine = make_backend(name, scene)
        state = engine.step(engine.reset(), np.zeros((1, engine.scene.model.nu)))
        if not np.isfinite(np.asarray(state.qpos)).all():
            raise ArithmeticError("the first step is not finite")
        device = getattr(engine, "device", None)
        return "steps" + (f" on {device}" if device else "")

    return _first_that_fits(stepped, _TRIAL, _FITTING)


def _renderer(name: str) -> str:
    from orbisim.registry import make_backend, make_renderer
    from orbisim.scene import load_scene

    def drawn(scene: str) -> str:
        loaded = load_scene(scene)
        renderer = make_renderer(name, loaded)
        state = make_backend("mujoco", loaded).reset()
        camera = 0 if loaded.model.ncam else -1
        height, width, _ = renderer.render(state, camera=camera, height=64, width=64).shape
        return f"draws {height} x {width}"

    return _first_that_fits(drawn, _TRIAL, _PUSHING)


def _first_that_fits(work: Callable[[str], str], *scenes: str) -> str:
    """Of trial scenes; that none fits is no fault of a plug-in that is made for others."""
    from orbisim.errors import InputError, UnknownNameError

    for scene in scenes:
        try:
            return work(scene)
        except UnknownNameError:
            raise
        except InputError as error:
            refused = error
    raise _NotThereError(f"loads, and takes no trial scene: {refused}")


_STAGE = """#usda 1.0
(
    upAxis = "Z"
)
def Sphere "ball" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])
{
}
"""
_DOCUMENTS = {
    ".xml": _TRIAL,
    ".mjcf": _TRIAL,
    ".urdf": '<robot name="trial"><link name="base"/></robot>',
    ".usd": _STAGE,
    ".usda": _STAGE,
}


def _reader(suffix: str) -> str:
    from orbisim.scene import load_scene
    from orbisim.scene.readers import reader_of_suffix

    reader = reader_of_suffix(suffix)
    if suffix not in _DOCUMENTS:
        _needs(f"reader {suffix!r}", suffix.removeprefix("."))
        return f"reader of {reader.format} loads"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"trial{suffix}")
        path.write_text(_DOCUMENTS[suffix], encoding="utf-8")
        load_scene(str(path))
    return f"reads {reader.format}"


_WITH = {
    "usdc": ("pxr", "usd"),
    "usdz": ("pxr", "usd"),
    "bag": ("rosbags", "logs"),
    "db3": ("rosbags", "logs"),
    "metadata.yaml": ("rosbags", "logs"),
    "mcap": ("mcap", "logs"),
}
"""Modules, and the extras that install them, of readers that import them when they read a file."""


def _needs(what: str, name: str) -> None:
    from orbisim.errors import MissingDependencyError

    module, extra = _WITH.get(name, ("", ""))
    if module and importlib.util.find_spec(module) is None:
        raise MissingDependencyError(what, extra, f"no module {module!r}")


def _log(group: str, name: str) -> str:
    from orbisim import plugins

    _needs(f"reader of logs {name!r}", name)
    return f"{plugins.load(group, name, 'reader of logs').__name__} loads"
