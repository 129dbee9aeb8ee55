"""A small web server for one page, on this machine only.

meshcat's own server listens on every network interface, chooses its port itself and queues
without bound for a browser that is slow. This one drops frames instead.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import queue
import sys
import threading
import webbrowser
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, Self

import tornado.httpserver
import tornado.netutil
import tornado.web
import tornado.websocket

from orbisim.errors import InputError

DEFAULT_PORT = 7000
"""As meshcat's."""
LOCAL = "127.0.0.1"

_HTTP = 80
"""The port that browsers leave out."""
_LAST_PORT = 65535
"""TCP ports have 16 bits."""
_FAREWELL = 1.0
"""How long pages may take to close their connections, s."""


class Server:
    """Serves a page at `/`, and sends frames to the pages that opened `/stream`.

    Runs in a thread of its own, between `with` and its end.

    Args:
      html: the page.
      port: None for 7000, or any free one if that is taken.

    Attributes:
      url: where the page is.
      requests: what the pages asked for (see `panel.Request`), oldest first.

    Raises:
      InputError: the port is taken, or not allowed.
    """

    def __init__(self, html: str, *, port: int | None = None) -> None:
        self._sockets = _bind(port)
        number = self._sockets[0].getsockname()[1]
        self.url = f"http://{LOCAL}:{number}/"
        self._names = _names_of(number)
        self.requests: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._html = html.encode()
        self._clients: set[_Stream] = set()
        self._latest = b""
        self._sending: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._stopping = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="orbisim-view", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def publish(self, frame: bytes, *, keep: bool = True) -> None:
        """Sends commands to the open pages.

        Args:
          frame: packed commands.
          keep: whether this is what a page that opens later starts from. Such frames replace each
            other, and a page that is slow to take one gets only the latest afterwards; others
            always arrive.
        """
        self._loop.call_soon_threadsafe(self._broadcast, frame, keep)

    def replace(self, html: str) -> None:
        """Serves another page to those that open it from now on."""
        self._html = html.encode()

    def close(self) -> None:
        """Disconnects the pages and stops the server."""
        with contextlib.suppress(KeyboardInterrupt):  # a second Ctrl-C: it is ending anyway
            if self._thread.is_alive():
                self._loop.call_soon_threadsafe(self._stopping.set)
                self._thread.join(2 * _FAREWELL)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    def refuses(self, handler: tornado.web.RequestHandler) -> bool:
        """Answers 403 to whom this server was not opened as; returns whether it did.

        A page elsewhere may let its own name point to this machine (DNS rebinding). The browser
        then takes it for a page of this server, but says in `Host` what it was called, and in
        `Origin` whose page asks.
        """
        host, origin = handler.request.host.lower(), handler.request.headers.get("Origin")
        ours = host in self._names
        if origin is not None:
            ours &= origin.lower() in {f"http://{name}" for name in self._names}
        if not ours:
            handler.set_status(403)
            handler.finish(f"this page is at {self.url} only\n")
        return not ours

    async def _serve(self) -> None:
        application = tornado.web.Application(
            [("/", _Page, {"server": self}), ("/stream", _Stream, {"server": self})],
            log_function=lambda handler: None,
        )
        server = tornado.httpserver.HTTPServer(application)
        server.add_sockets(self._sockets)
        await self._stopping.wait()
        server.stop()
        for client in set(self._clients):
            client.close()
        deadline = self._loop.time() + _FAREWELL
        while self._clients and self._loop.time() < deadline:
            await asyncio.sleep(0.01)
        await server.close_all_connections()

    def _broadcast(self, frame: bytes, keep: bool) -> None:
        if keep:
            self._latest = frame
        for client in self._clients:
            if not keep:
                self._start(client.send(frame))
            elif not client.busy:
                client.busy = True
                self._start(client.catch_up())

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        self._sending.add(task)  # the loop itself does not keep it alive
        task.add_done_callback(self._sending.discard)


class _Page(tornado.web.RequestHandler):
    def initialize(self, server: Any) -> None:
        self._server = server

    def prepare(self) -> None:
        self._server.refuses(self)

    def get(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(self._server._html)


class _Stream(tornado.websocket.WebSocketHandler):
    """A page's connection.

    Attributes:
      busy: whether frames are on their way to the page.
    """

    busy = False

    def initialize(self, server: Any) -> None:
        self._server = server
        self._shown = b""

    def prepare(self) -> None:
        self._server.refuses(self)

    async def open(self, *args: str, **kwargs: str) -> None:
        self._server._clients.add(self)
        self.busy = True
        await self.catch_up()

    async def catch_up(self) -> None:
        """Sends the latest frame, and again if there is a later one by the time it has gone."""
        try:
            while self._shown is not self._server._latest:
                self._shown = self._server._latest
                await self.send(self._shown)
        finally:
            self.busy = False

    async def send(self, frame: bytes) -> None:
        try:
            await self.write_message(frame, binary=True)
        except tornado.websocket.WebSocketClosedError:
            self._server._clients.discard(self)

    def on_message(self, message: str | bytes) -> None:
        self._server.requests.put(str(message))

    def on_close(self) -> None:
        self._server._clients.discard(self)


def _bind(port: int | None) -> list[Any]:
    if port is not None and not 0 <= port <= _LAST_PORT:
        raise InputError(f"a port is a number from 0 to {_LAST_PORT}; got {port}")
    try:
        return tornado.netutil.bind_sockets(DEFAULT_PORT if port is None else port, LOCAL)
    except OSError as error:
        if port is None:
            return tornado.netutil.bind_sockets(0, LOCAL)
        taken = error.errno == errno.EADDRINUSE
        why = "is taken by another program" if taken else f"cannot be used ({error})"
        raise InputError(f"port {port} {why}; choose another, or none for any free one") from None


def _names_of(port: int) -> frozenset[str]:
    """What a browser on this machine, or one whose port is forwarded here, calls the server."""
    hosts = {"localhost", LOCAL, "[::1]"}
    names = {f"{host}:{port}" for host in hosts}
    return frozenset(names | hosts if port == _HTTP else names)


def print_url(url: str) -> None:
    """Says on standard output where the page is."""
    print(f"open {url} in a browser; Ctrl-C here ends it", flush=True)


def announce(server: Server, on_ready: Callable[[str], None] | None, open_browser: bool) -> None:
    """Tells where the page is, and opens it in a browser if asked to and there is one."""
    (on_ready or print_url)(server.url)
    if open_browser and not _opened(server.url):
        print(f"no browser could be started here; open {server.url} yourself", file=sys.stderr)


def _opened(url: str) -> bool:
    try:
        return webbrowser.open(url, new=2)
    except webbrowser.Error:
        return False
