"""A backend running live."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.errors import InputError, OrbiSimError
from orbisim.registry import available_backends, make_backend
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.view.drawing import Drawing
from orbisim.view.options import SOLID, ViewOptions
from orbisim.view.page import Caption, page
from orbisim.view.panel import SPEEDS, TOGGLES, Request, panel, request_of, scalar_joints
from orbisim.view.server import Server, announce
from orbisim.view.simulation import Pace, Policy, Simulation
from orbisim.view.stage import stage
from orbisim.view.three import Json, packed


def view_live(
    scene: Scene,
    backend: str | Backend = "mujoco",
    controls: npt.ArrayLike | Policy | None = None,
    *,
    nstep: int = 1,
    state: State | None = None,
    duration: float | None = None,
    realtime: bool = True,
    fps: float = 30.0,
    port: int | None = None,
    open_browser: bool = False,
    on_ready: Callable[[str], None] | None = None,
    title: str | None = None,
    device: str | None = None,
    options: ViewOptions | None = None,
) -> State:
    """Simulates one world and shows it in web pages, until `duration` is over or Ctrl-C.

    Every page that opens shows the simulation as it is then, and can pause and restart it.

    Args:
      scene: the scene.
      backend: a registered name, or a backend object, into which the scene is loaded.
      controls: a policy; a sequence [T, nu], after which the simulation ends; or None for zeros.
      nstep: backend steps for which each control is held.
      state: where to start, with one world; the backend's reset if None.
      duration: simulated time, s; None for no end.
      realtime: keep pace with the clock; otherwise as fast as the backend is.
      fps: frames sent per second.
      port: of the server; None for 7000, or any free one if that is taken.
      open_browser: whether to open a page in a browser.
      on_ready: called with the page's address; prints it if None.
      title: of the page; the scene's name if None.
      device: where the backend computes, when it is given by name.
      options: what to show.

    Returns:
      The last state.

    Raises:
      DivergedError: the simulation became non-finite; the pages say so.
      InputError: the port is taken, or controls or state do not fit the scene.
      UnknownNameError: no backend has this name.
    """
    if not fps > 0 or nstep < 1 or (duration is not None and not duration > 0):
        raise InputError(
            "fps and duration must be above 0 and nstep at least 1; "
            f"got {fps}, {duration} and {nstep}"
        )
    with _loaded(backend, scene, device) as engine:
        simulation = Simulation(engine, state, controls, nstep)
        options = options or ViewOptions()
        drawing = Drawing(scene.model, options)
        simulation.place(drawing)
        commands = [*stage(drawing.kinematics, drawing.parts, options), *drawing.create()]
        offers = panel(scene, drawing, engine.name, available_backends())
        caption = Caption(f"{title or scene.name} ({engine.name})")
        html = page(commands, caption, options.theme, live=offers)
        with Server(html, port=port) as server:
            announce(server, on_ready, open_browser)
            show = Show(scene, simulation, drawing, server, Pace(fps, realtime), caption.title)
            show.run(duration)
        return simulation.state


@contextlib.contextmanager
def _loaded(backend: str | Backend, scene: Scene, device: str | None) -> Iterator[Backend]:
    """A backend with the scene loaded; closed in the end if it was made here."""
    if isinstance(backend, Backend):
        backend.load(scene)
        yield backend
        return
    engine = make_backend(backend, scene, device=device)
    try:
        yield engine
    finally:
        engine.close()


class Show:
    """Sends a simulation to the pages and does what they ask for."""

    def __init__(
        self,
        scene: Scene,
        simulation: Simulation,
        drawing: Drawing,
        server: Server,
        pace: Pace,
        title: str,
    ) -> None:
        self._scene, self._title = scene, title
        self._simulation, self._drawing = simulation, drawing
        self._server, self._pace = server, pace
        self._paused = False
        self._joints = scalar_joints(scene.model)
        self._engines: dict[str, Backend] = {}
        self._name = title.rpartition("(")[2].rstrip(")")

    def run(self, duration: float | None) -> None:
        """Runs until `duration`, Ctrl-C, the end of the controls or an error, which pages show."""
        try:
            self._run(duration)
        except KeyboardInterrupt:
            pass
        except OrbiSimError as error:
            self._tell(str(error))
            raise
        finally:
            for engine in self._engines.values():
                engine.close()

    def _tell(self, text: str) -> None:
        self._server.publish(packed({"type": "notice", "text": text}), keep=False)

    def _run(self, duration: float | None) -> None:
        simulation, pace = self._simulation, self._pace
        pace.start(0.0)
        self._publish()
        going = True
        while going and (duration is None or simulation.elapsed < duration - 1e-9):
            self._obey()
            if self._paused:
                time.sleep(pace.frame)
                continue
            until = simulation.elapsed + pace.frame * pace.speed
            going = simulation.advance(until if duration is None else min(until, duration))
            pace.keep(simulation.elapsed)
            if pace.due():
                self._publish()
        self._publish()

    def _obey(self) -> None:
        while not self._server.requests.empty():
            request = request_of(self._server.requests.get())
            if request is not None and request.do in self._ACTIONS:
                self._ACTIONS[request.do](self, request)
                self._pace.start(self._simulation.elapsed)

    def _pause(self, request: Request) -> None:
        self._paused = not self._paused

    def _restart(self, request: Request) -> None:
        self._simulation.restart()
        self._publish()

    def _step(self, request: Request) -> None:
        self._paused = True
        self._simulation.step_once()
        self._publish()

    def _speed(self, request: Request) -> None:
        self._pace.speed = min(max(request.value, SPEEDS[0]), SPEEDS[1])

    def _joint(self, request: Request) -> None:
        if 0 <= request.index < len(self._joints):
            address = int(self._scene.model.jnt_qposadr[self._joints[request.index]])
            self._simulation.place_joint(address, request.value)
            self._publish()

    def _control(self, request: Request) -> None:
        if 0 <= request.index < self._scene.model.nu:
            self._simulation.command(request.index, request.value)

    def _manual(self, request: Request) -> None:
        if not request.value:
            self._simulation.release()

    def _show(self, request: Request) -> None:
        """Draws the scene anew with or without something."""
        on, options = bool(request.value), self._drawing.options
        if request.name == "collisions":
            groups = {*options.groups, 3} if on else {*options.groups} - {3}
            options = dataclasses.replace(options, groups=tuple(sorted(groups)))
        elif request.name in TOGGLES:
            changed: dict[str, Any] = {request.name: on}
            options = dataclasses.replace(options, **changed)
        self._drawing = Drawing(self._scene.model, options)
        self._simulation.place(self._drawing)
        commands = [{"type": "delete", "path": SOLID.root}, *self._drawing.create()]
        self._server.publish(b"".join(packed(command) for command in commands), keep=False)
        self._serve_anew()

    def _backend(self, request: Request) -> None:
        try:
            if request.name not in self._engines:
                self._engines[request.name] = make_backend(request.name, self._scene)
            self._simulation.use(self._engines[request.name])
        except (OrbiSimError, ImportError) as error:
            self._tell(f"{request.name}: {error}")
            return
        self._name = request.name
        self._serve_anew()
        self._publish()

    def _serve_anew(self) -> None:
        """Pages that open later see what is shown now."""
        drawing = self._drawing
        commands = [*stage(drawing.kinematics, drawing.parts, drawing.options), *drawing.create()]
        offers = panel(self._scene, drawing, self._name, available_backends())
        caption = Caption(f"{self._title.rpartition(' (')[0]} ({self._name})")
        self._server.replace(page(commands, caption, drawing.options.theme, live=offers))

    _ACTIONS: ClassVar[dict[str, Callable[[Any, Request], None]]] = {
        "pause": _pause,
        "restart": _restart,
        "step": _step,
        "speed": _speed,
        "joint": _joint,
        "control": _control,
        "manual": _manual,
        "show": _show,
        "backend": _backend,
    }

    def _publish(self) -> None:
        self._simulation.place(self._drawing)
        elapsed = self._simulation.elapsed
        clock: Json = {"type": "set_clock", "text": f"{elapsed:.2f} s, {self._name}"}
        addresses = self._scene.model.jnt_qposadr[self._joints]
        placed = self._simulation.state.numpy().qpos[0, addresses]
        joints: Json = {"type": "set_joints", "values": [float(value) for value in placed]}
        commands = [*self._drawing.update(), clock, joints]
        self._server.publish(b"".join(packed(command) for command in commands))
