"""A headless Chromium with software WebGL, driven over its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Self

import numpy as np
import tornado.websocket
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
)


def executable() -> str | None:
    """The browser's path, None if there is none."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Chromium:
    """One page of a browser of its own.

    Attributes:
      errors: JavaScript exceptions and errors written to the console.
      requests: addresses that pages asked for, without `data:` ones.
    """

    def __init__(self, profile: Path, width: int = 800, height: int = 560) -> None:
        self._profile, self._size = profile, (width, height)
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._answers: dict[int, Any] = {}
        self._sent = 0
        self._loop = asyncio.new_event_loop()

    def __enter__(self) -> Self:
        path = executable()
        assert path is not None
        arguments = [path, *_FLAGS, f"--user-data-dir={self._profile}", "about:blank"]
        self._process = subprocess.Popen(
            arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            self._loop.run_until_complete(self._connect())
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._loop.run_until_complete(self._disconnect())
        self._end()

    async def _disconnect(self) -> None:
        """Closes the connection, for which a loop must run."""
        self._socket.close()

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(60)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._loop.close()

    async def _connect(self) -> None:
        told = self._profile / "DevToolsActivePort"
        deadline = time.monotonic() + 120
        while not (told.exists() and told.read_text().count("\n")):
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("the browser did not start")
            await asyncio.sleep(0.05)
        port, path = told.read_text().splitlines()[:2]
        self._socket = await tornado.websocket.websocket_connect(
            f"ws://127.0.0.1:{port}{path}", max_message_size=2**28
        )
        self._session = None
        target = await self._call("Target.createTarget", url="about:blank")
        attached = await self._call("Target.attachToTarget", flatten=True, **target)
        self._session = attached["sessionId"]
        for domain in ("Runtime", "Page", "Network", "Log"):
            await self._call(f"{domain}.enable")
        width, height = self._size
        await self._call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    async def _call(self, method: str, **parameters: Any) -> Any:
        self._sent += 1
        message: dict[str, Any] = {"id": self._sent, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        await self._socket.write_message(json.dumps(message))
        while True:
            text = await asyncio.wait_for(self._socket.read_message(), 60)
            if text is None:
                raise RuntimeError("the browser closed the connection")
            answer = json.loads(text)
            if answer.get("id") == self._sent:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._note(answer.get("method"), answer.get("params", {}))

    def _note(self, event: str | None, what: dict[str, Any]) -> None:
        if event == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(what["exceptionDetails"].get("exception", what)))
        elif event == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning"):
            self.errors.append(json.dumps([a.get("value") for a in what["args"]]))
        elif event == "Log.entryAdded" and what["entry"]["level"] == "error":
            self.errors.append(what["entry"]["text"])
        elif event == "Network.requestWillBeSent":
            url = what["request"]["url"]
            if not url.startswith(("data:", "blob:")):
                self.requests.append(url)

    def open(self, url: str) -> None:
        """Opens a page of the viewer and waits until it has drawn everything."""
        self._loop.run_until_complete(self._open(url))

    def visit(self, url: str) -> None:
        """Opens any page and waits until it is complete."""
        self._loop.run_until_complete(self._go(url))
        self.wait_for(f"document.readyState === 'complete' && location.href === {json.dumps(url)}")

    async def _go(self, url: str) -> None:
        self.errors.clear()
        self.requests.clear()
        await self._call("Page.navigate", url="about:blank")
        await self._call("Page.navigate", url=url)

    async def _open(self, url: str) -> None:
        await self._go(url)
        await self._evaluate(
            "new Promise((done) => { const look = () => window.orbisim ? done() : "
            "setTimeout(look, 20); look(); }).then(() => window.orbisim.ready)"
        )

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, as JSON carries it; promises are awaited."""
        return self._loop.run_until_complete(self._evaluate(expression))

    async def _evaluate(self, expression: str) -> Any:
        answer = await self._call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise AssertionError(json.dumps(answer["exceptionDetails"])[:2000])
        return answer["result"].get("value")

    def click(self, element: str, along: float = 0.5) -> None:
        """Presses the mouse on an element and lets go.

        Args:
          element: JavaScript expression of it. along: where, as a share of its width.
        """
        x, y = self.evaluate(
            f"(() => {{ const e = {element}; e.scrollIntoView({{ block: 'nearest' }});"
            "const box = e.getBoundingClientRect();"
            f"return [box.x + {along} * box.width, box.y + box.height / 2]; }})()"
        )
        for kind, held in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 0)):
            self._loop.run_until_complete(
                self._call(
                    "Input.dispatchMouseEvent",
                    type=kind, x=x, y=y, buttons=held, clickCount=int(kind != "mouseMoved"),
                    button="none" if kind == "mouseMoved" else "left",
                )
            )  # fmt: skip

    def wait_for(self, condition: str, seconds: float = 120) -> None:
        """Waits until a JavaScript expression is true."""
        deadline = time.monotonic() + seconds
        while not self.evaluate(condition):
            assert time.monotonic() < deadline, f"still false: {condition}"
            time.sleep(0.05)

    def screenshot(self, path: Path | None = None) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """[height, width, 3]: what the page shows."""
        self.evaluate(
            "new Promise((done) => { window.orbisim.viewer.set_dirty(); "
            "requestAnimationFrame(() => requestAnimationFrame(() => done(true))); })"
        )
        answer = self._loop.run_until_complete(self._call("Page.captureScreenshot", format="png"))
        png = base64.b64decode(answer["data"])
        if path is not None:
            path.write_bytes(png)
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
