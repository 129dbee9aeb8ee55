"""A backend running live."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.errors import InputError, OrbiSimError
from orbisim.registry import make_backend
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.view.drawing import Drawing
from orbisim.view.options import ViewOptions
from orbisim.view.page import Caption, page
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
        caption = Caption(f"{title or scene.name} ({engine.name})")
        html = page(commands, caption, options.theme, live=True)
        with Server(html, port=port) as server:
            announce(server, on_ready, open_browser)
            Show(simulation, drawing, server, Pace(fps, realtime)).run(duration)
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
        self, simulation: Simulation, drawing: Drawing, server: Server, pace: Pace
    ) -> None:
        self._simulation, self._drawing = simulation, drawing
        self._server, self._pace = server, pace
        self._paused = False

    def run(self, duration: float | None) -> None:
        """Runs until `duration`, Ctrl-C, the end of the controls or an error, which pages show."""
        try:
            self._run(duration)
        except KeyboardInterrupt:
            pass
        except OrbiSimError as error:
            self._server.publish(packed({"type": "notice", "text": str(error)}), keep=False)
            raise

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
            until = simulation.elapsed + pace.frame
            going = simulation.advance(until if duration is None else min(until, duration))
            pace.keep(simulation.elapsed)
            if pace.due():
                self._publish()
        self._publish()

    def _obey(self) -> None:
        while not self._server.requests.empty():
            request = self._server.requests.get()
            if request == "pause":
                self._paused = not self._paused
            elif request == "restart":
                self._simulation.restart()
                self._publish()
            self._pace.start(self._simulation.elapsed)

    def _publish(self) -> None:
        self._simulation.place(self._drawing)
        clock: Json = {"type": "set_clock", "text": f"{self._simulation.elapsed:.2f} s"}
        commands = [*self._drawing.update(), clock]
        self._server.publish(b"".join(packed(command) for command in commands))
