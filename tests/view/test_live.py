"""Live simulation: what pages receive over their connection, and how it ends."""

from __future__ import annotations

import asyncio
import http.client
import queue
import socket
import threading
import time
import urllib.request
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import mujoco
import numpy as np
import pytest
import tornado.httpclient
import tornado.websocket

from orbisim.backend import Backend
from orbisim.errors import DivergedError, InputError, UnknownNameError
from orbisim.registry import make_backend
from orbisim.scene import Scene, load_scene
from orbisim.state import State
from orbisim.view import ViewOptions, view_live, view_trajectory
from orbisim.view.drawing import Drawing
from orbisim.view.server import Server
from orbisim.view.simulation import Simulation
from orbisim.view.three import packed
from tests.clock import Stopwatch
from tests.view.scenes import CLOTH, commands_of, matrix_of, showcase, unpacked

PENDULUM = load_scene(
    "<mujoco model='pendulum'><option timestep='.01'/><worldbody><body name='pole'>"
    "<joint name='hinge' axis='0 1 0'/><geom type='capsule' fromto='0 0 0 .5 0 0' size='.05'/>"
    "</body></worldbody><actuator><motor joint='hinge'/></actuator></mujoco>"
)


class Page:
    """A page without a browser: keeps what the server sends."""

    def __init__(self, url: str) -> None:
        self.received: queue.Queue[list[dict[str, Any]] | None] = queue.Queue()
        self._url = url
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        self._loop.run_until_complete(self._listen())

    async def _listen(self) -> None:
        address = self._url.replace("http", "ws") + "stream"
        self._connection = await tornado.websocket.websocket_connect(address)
        while (message := await self._connection.read_message()) is not None:
            self.received.put(unpacked(message))
        self.received.put(None)

    def ask(self, what: str) -> None:
        self._loop.call_soon_threadsafe(self._connection.write_message, what)

    def next(self) -> list[dict[str, Any]]:
        frame = self.received.get(timeout=120)
        assert frame is not None, "the server closed the connection"
        return frame

    def until_closed(self) -> list[list[dict[str, Any]]]:
        frames = []
        while (frame := self.received.get(timeout=120)) is not None:
            frames.append(frame)
        return frames


def clock(frame: list[dict[str, Any]]) -> float:
    (text,) = [c["text"] for c in frame if c["type"] == "set_clock"]
    return float(text.split()[0])


class Live:
    """`view_live` in a thread of its own."""

    def __init__(self, *arguments: Any, **choices: Any) -> None:
        self._ready: queue.Queue[str] = queue.Queue()
        self.result: Any = None
        self.error: BaseException | None = None
        self._arguments, self._choices = arguments, choices | {"on_ready": self._ready.put}
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()
        self.url = self._ready.get(timeout=120)

    def _run(self) -> None:
        try:
            self.result = view_live(*self._arguments, **self._choices)
        except BaseException as error:
            self.error = error

    def finish(self) -> Any:
        self.thread.join(30)
        assert not self.thread.is_alive()
        if self.error is not None:
            raise self.error
        return self.result


@contextmanager
def live(*arguments: Any, **choices: Any) -> Iterator[Live]:
    """A live simulation that is certainly over at the end."""
    stop = threading.Event()
    inner = choices.pop("controls", None)

    def policy(state: State) -> Any:
        if stop.is_set():
            raise KeyboardInterrupt
        return inner(state) if inner else np.zeros(arguments[0].model.nu)

    running = Live(*arguments, controls=policy, **choices)
    try:
        yield running
    finally:
        stop.set()
        running.thread.join(30)


def test_pages_receive_the_poses_of_the_simulation() -> None:
    with live(PENDULUM) as running:
        html = urllib.request.urlopen(running.url).read().decode()
        page = Page(running.url)
        frames = [page.next() for _ in range(5)]
    drawn = [c["path"] for c in commands_of(html) if c["type"] == "set_object"]
    path = Drawing(PENDULUM.model).bodies[1]
    assert any(p.startswith(path) for p in drawn)
    assert "pendulum (mujoco)" in html and '"live": true' in html
    times = [clock(frame) for frame in frames]
    assert times == sorted(times) and times[-1] > times[0]
    backend = make_backend("mujoco", PENDULUM)
    for frame, elapsed in zip(frames, times, strict=True):
        steps = round(elapsed / 0.01)
        state = backend.step(backend.reset(1), None, steps) if steps else backend.reset(1)
        (got,) = [matrix_of(c["matrix"]) for c in frame if c["type"] == "set_transform"]
        data = mujoco.MjData(PENDULUM.model)
        data.qpos[:] = state.qpos[0]
        mujoco.mj_kinematics(PENDULUM.model, data)
        np.testing.assert_allclose(got[:3, :3].ravel(), data.xmat[1], atol=1e-6)


def test_keeps_pace_with_the_clock() -> None:
    started = time.perf_counter()
    state = Live(PENDULUM, duration=0.6).finish()
    assert time.perf_counter() - started > 0.55
    assert state.time[0] == pytest.approx(0.6)


def test_as_fast_as_possible() -> None:
    watch = Stopwatch()
    state = Live(PENDULUM, duration=30.0, realtime=False).finish()
    assert watch.seconds < 15
    assert state.time[0] == pytest.approx(30.0)


def test_a_sequence_of_controls_is_followed_to_its_end() -> None:
    controls = np.random.default_rng(0).uniform(-1, 1, (40, 1))
    state = Live(PENDULUM, "mujoco", controls, nstep=2, realtime=False).finish()
    backend = make_backend("mujoco", PENDULUM)
    expected = backend.rollout(backend.reset(1), controls, nstep=2).final
    np.testing.assert_array_equal(state.qpos, expected.qpos)
    np.testing.assert_array_equal(state.qvel, expected.qvel)


def test_a_policy_sees_the_state_and_starts_where_told() -> None:
    backend = make_backend("mujoco", PENDULUM)
    start = backend.reset(1)
    start = start.replace(qpos=start.qpos + 0.7)
    seen: list[float] = []

    def policy(state: State) -> Any:
        seen.append(float(state.qpos[0, 0]))
        return -state.qpos[0]

    state = Live(PENDULUM, backend, policy, state=start, duration=0.1, realtime=False).finish()
    assert seen[0] == pytest.approx(0.7)
    assert len(seen) == 10
    current = start
    for _ in range(10):
        current = backend.step(current, -current.qpos[0])
    np.testing.assert_array_equal(state.qpos, current.qpos)


def test_pages_can_pause_and_restart() -> None:
    with live(PENDULUM) as running:
        page = Page(running.url)
        while clock(page.next()) < 0.1:
            pass
        page.ask("pause")
        time.sleep(0.3)
        while not page.received.empty():
            page.next()
        time.sleep(0.3)
        assert page.received.empty()
        page.ask("pause")
        resumed = clock(page.next())
        page.ask("restart")
        deadline = time.monotonic() + 120
        while clock(page.next()) >= resumed:
            assert time.monotonic() < deadline


def test_ctrl_c_ends_it_cleanly() -> None:
    with live(PENDULUM) as running:
        page = Page(running.url)
        page.next()
    assert running.error is None
    assert running.result.nworld == 1
    page.until_closed()
    with pytest.raises(OSError):
        urllib.request.urlopen(running.url)


class Exploding(Backend):
    """Returns NaN after a while, without saying so."""

    name = "exploding"
    scene_seen: ClassVar[Scene | None] = None

    def load(self, scene: Scene) -> None:
        self._scene = scene

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        zeros = np.zeros((1, 1))
        return State(time=np.zeros(1), qpos=zeros, qvel=zeros, act=np.zeros((1, 0)))

    def step(self, state: State, control: Any = None, nstep: int = 1) -> State:
        moved = state.qpos + 0.1
        return state.replace(qpos=np.where(moved > 1, np.nan, moved), time=state.time + 0.01)


def test_divergence_is_told_and_nothing_of_it_is_shown() -> None:
    go = threading.Event()

    def policy(state: State) -> Any:
        go.wait(120)
        return np.zeros(1)

    running = Live(PENDULUM, Exploding(), policy)
    page = Page(running.url)
    page.next()
    go.set()
    with pytest.raises(DivergedError, match="not finite after"):
        running.finish()
    commands = [c for frame in page.until_closed() for c in frame]
    (notice,) = [c["text"] for c in commands if c["type"] == "notice"]
    assert "exploding" in notice
    for command in commands:
        if command["type"] == "set_transform":
            assert np.isfinite(command["matrix"]).all()


def test_flexes_and_mocap_bodies_are_sent_too() -> None:
    scene = load_scene(CLOTH)
    running = Live(scene, duration=1.0)
    page = Page(running.url)
    sent = page.next()
    running.finish()
    vertices = [c for c in sent if c["type"] == "set_vertices"]
    assert sum(len(c["positions"]) for c in vertices) == 3 * scene.model.nflexvert
    scene = showcase()
    backend = make_backend("mujoco", scene)
    start = backend.reset(1)
    start = start.with_memory(mocap_pos=np.array([[[0.0, 0.0, 5.0]]]))
    running = Live(scene, backend, state=start, duration=0.5)
    sent = Page(running.url).next()
    path = Drawing(scene.model).bodies[scene.model.body("target").id]
    (target,) = [c for c in sent if c.get("path") == path]
    assert matrix_of(target["matrix"])[2, 3] == 5.0
    running.finish()


def taken_port() -> tuple[socket.socket, int]:
    other = socket.socket()
    other.bind(("127.0.0.1", 0))
    other.listen()
    return other, other.getsockname()[1]


def test_a_taken_port() -> None:
    other, port = taken_port()
    with other, pytest.raises(InputError, match=f"port {port} is taken"):
        view_live(PENDULUM, duration=0.1, port=port)
    with pytest.raises(InputError, match="from 0 to 65535"):
        Server("", port=99999)


def test_two_at_a_time_get_ports_of_their_own() -> None:
    with Server("first") as first, Server("second") as second:
        assert first.url != second.url
        assert urllib.request.urlopen(second.url).read() == b"second"
    assert first.url.startswith("http://127.0.0.1:")


def test_only_pages_of_this_server_may_connect() -> None:
    async def connect(url: str) -> None:
        request = tornado.httpclient.HTTPRequest(url, headers={"Origin": "http://elsewhere.test"})
        await tornado.websocket.websocket_connect(request)

    with Server("") as server:
        with pytest.raises(tornado.httpclient.HTTPClientError, match="403"):
            asyncio.run(connect(server.url.replace("http", "ws") + "stream"))
        assert server.requests.empty()


@pytest.mark.parametrize("place", ["", "stream"])
@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("127.0.0.1:{port}", None, 200),
        ("LOCALHOST:{port}", "http://localhost:{port}", 200),
        ("[::1]:{port}", "http://[::1]:{port}", 200),
        ("rebound.test:{port}", None, 403),
        ("rebound.test:{port}", "http://rebound.test:{port}", 403),
        ("localhost.rebound.test:{port}", None, 403),
        ("127.0.0.1", None, 403),
        ("", None, 403),
        ("127.0.0.1:{port}", "http://rebound.test:{port}", 403),
        ("127.0.0.1:{port}", "null", 403),
    ],
)
def test_names_that_point_here_are_no_way_in(
    place: str, host: str, origin: str | None, status: int
) -> None:
    """A page elsewhere may let its name point to this machine: DNS rebinding."""
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    with Server("page") as server:
        port = int(server.url.rstrip("/").rpartition(":")[2])
        headers = {"Host": host.format(port=port), **(upgrade if place else {})}
        if origin is not None:
            headers["Origin"] = origin.format(port=port)
        connection = http.client.HTTPConnection("127.0.0.1", port)
        connection.request("GET", f"/{place}", headers=headers)
        expected = 101 if place and status == 200 else status
        assert connection.getresponse().status == expected
        connection.close()
    assert server.requests.empty()


def test_slow_pages_miss_frames_but_no_notices() -> None:
    with Server("") as server:
        page = Page(server.url)
        filler = "x" * 2_000_000
        deadline = time.monotonic() + 120
        while not server._clients:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for number in range(100):
            server.publish(packed({"type": "set_clock", "text": f"{number} {filler}"}))
        server.publish(packed({"type": "notice", "text": "over"}), keep=False)
        frames: list[dict[str, Any]] = []
        told: set[str] = set()
        while told != {"99", "over"}:
            (command,) = page.next()
            frames.append(command)
            told |= {command["text"].split()[0]} & {"99", "over"}
    assert len(frames) < 101


@pytest.mark.parametrize(
    "wrong",
    [{"fps": 0.0}, {"duration": 0.0}, {"nstep": 0}, {"controls": np.zeros((3, 2))}],
)
def test_wrong_choices(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        view_live(PENDULUM, **wrong)


def test_wrong_states_and_names() -> None:
    backend = make_backend("mujoco", PENDULUM)
    with pytest.raises(InputError, match="one world"):
        view_live(PENDULUM, backend, state=backend.reset(2))
    with pytest.raises(InputError, match="qpos"):
        other = make_backend("mujoco", showcase())
        view_live(PENDULUM, state=other.reset(1))
    start = backend.reset(1)
    with pytest.raises(InputError, match="not finite"):
        view_live(PENDULUM, backend, state=start.replace(qvel=start.qvel * np.nan))
    with pytest.raises(UnknownNameError):
        view_live(PENDULUM, "mujocco")


def test_a_sequence_starts_anew_with_the_simulation() -> None:
    backend = make_backend("mujoco", PENDULUM)
    simulation = Simulation(backend, None, np.ones((4, 1)))
    assert simulation.advance(0.03)
    first = simulation.state
    simulation.restart()
    assert simulation.elapsed == 0
    assert simulation.advance(0.03)
    np.testing.assert_array_equal(simulation.state.qpos, first.qpos)
    assert not simulation.advance(0.1)


def test_without_a_browser(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(url: str, new: int = 0) -> bool:
        raise webbrowser.Error("none")

    monkeypatch.setattr(webbrowser, "open", fails)
    view_live(PENDULUM, duration=0.05, realtime=False, open_browser=True)
    told = capsys.readouterr()
    assert "http://127.0.0.1:" in told.out
    assert "no browser could be started" in told.err


def test_view_trajectory_serves_the_page() -> None:
    pages: list[str] = []
    view_trajectory(
        PENDULUM,
        None,
        duration=0.5,
        title="served",
        options=ViewOptions(background="dark"),
        on_ready=lambda url: pages.append(urllib.request.urlopen(url).read().decode()),
    )
    assert "<h1>served</h1>" in pages[0]
