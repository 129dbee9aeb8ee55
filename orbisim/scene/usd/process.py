"""Runs the dumping process and keeps it within its limits."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO

from orbisim.errors import MissingDependencyError, SceneError
from orbisim.files.budget import Budget, Limits
from orbisim.scene.safety.confine import confinement
from orbisim.scene.usd.flat import FlatStage
from orbisim.scene.usd.wire import decode

_MEGABYTE = 2**20  # bytes
_WATCH = 0.02
"""Seconds between looks at the time that the process has used."""
_MAX_DUMP, _PER_BYTE = 64 * _MEGABYTE, 32
"""Largest dump that is accepted, and by how much it may grow with each byte of input."""

_BOOT = """
import json, sys, types
options = json.loads(sys.argv[1])
sys.path[:] = options["sys_path"]
for name, folder in options["packages"]:
    module = types.ModuleType(name)
    module.__path__ = [folder]
    sys.modules[name] = module
from orbisim.scene.usd.dump.main import main
sys.exit(main(options))
"""
"""What the process runs. The packages around the dump are stood in for by empty ones: importing
`orbisim.scene` loads MuJoCo, which takes longer than reading most stages."""


def dump_stage(path: str, limits: Limits | None = None) -> FlatStage:
    """Reads a USD file in a process of its own.

    Raises:
      SceneError: the file cannot be read, or doing so takes too much time or memory.
      MissingDependencyError: OpenUSD is not installed.
    """
    if importlib.util.find_spec("pxr") is None:
        raise MissingDependencyError("USD scenes", "usd")
    own_size = Path(path).stat().st_size
    limits = (limits or Limits()).for_input_of(own_size)
    with tempfile.TemporaryFile() as errors:
        child = subprocess.Popen(
            _command(path, limits),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            env={**os.environ, "PXR_WORK_THREAD_LIMIT": "1", "MALLOC_ARENA_MAX": "2"},
            start_new_session=True,
        )
        try:
            assert child.stdout is not None
            return _Conversation(path, limits, own_size).follow(child, child.stdout, errors)
        finally:
            child.kill()
            child.wait()
            if child.stdout is not None:
                child.stdout.close()


def _command(path: str, limits: Limits) -> list[str]:
    here, root = Path(__file__).resolve().parent, confinement()
    packages = [
        ("orbisim", here.parents[1]),
        ("orbisim.scene", here.parent),
        ("orbisim.scene.usd", here),
    ]
    options = {
        "path": str(Path(path).resolve()),
        "root": str(root) if root else None,
        "memory": limits.memory,
        "seconds": limits.seconds,
        "packages": [(name, str(folder)) for name, folder in packages],
        "sys_path": [entry for entry in sys.path if entry],
    }
    return [sys.executable, "-P", "-c", _BOOT, json.dumps(options)]


class _Conversation:
    """Follows what a dumping process says until it is done or out of bounds."""

    def __init__(self, path: str, limits: Limits, own_size: int) -> None:
        self._path, self._limits = path, limits
        self._input = own_size
        self._buffer = bytearray()

    def follow(
        self, child: subprocess.Popen[bytes], stream: IO[bytes], errors: IO[bytes]
    ) -> FlatStage:
        self._budget = Budget(child.pid)
        while True:
            kind, payload = self._message(stream)
            if kind == b"B":
                self._extend(int(payload))
            elif kind == b"S":
                return decode(payload)
            elif kind == b"E":
                report = json.loads(payload)
                absolute = str(Path(self._path).resolve())
                raise SceneError(
                    self._path,
                    report["problem"].replace(absolute, self._path),
                    element=report["element"],
                    remedy=report["remedy"],
                )
            else:
                raise self._crash(child, errors)

    def _extend(self, nbytes: int) -> None:
        self._input += nbytes
        longer = self._limits.seconds + nbytes / _MEGABYTE
        self._limits = dataclasses.replace(self._limits, seconds=longer)

    def _message(self, stream: IO[bytes]) -> tuple[bytes, bytes]:
        """The next message, or two empty strings at the end of the stream."""
        head = self._read(stream, 9)
        if len(head) < 9:
            return b"", b""
        size = int.from_bytes(head[1:], "little")
        if size > _MAX_DUMP + _PER_BYTE * self._input:
            raise SceneError(
                self._path,
                f"its contents come to {size // _MEGABYTE} MB, which is out of proportion to "
                f"the {self._input / _MEGABYTE:.3g} MB of the file",
            )
        payload = self._read(stream, size)
        return (head[:1], payload) if len(payload) == size else (b"", b"")

    def _read(self, stream: IO[bytes], size: int) -> bytes:
        while len(self._buffer) < size:
            ready, _, _ = select.select([stream], [], [], _WATCH)
            if not ready:
                if excess := self._budget.excess(self._limits):
                    remedy = "split it into smaller layers"
                    raise SceneError(self._path, excess, remedy=remedy)
                continue
            chunk = os.read(stream.fileno(), _MEGABYTE)
            if not chunk:
                break
            self._buffer += chunk
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken

    def _crash(self, child: subprocess.Popen[bytes], errors: IO[bytes]) -> SceneError:
        """What to say about a process that ended without an answer."""
        code = child.wait(timeout=self._limits.stall)
        errors.seek(0)
        said = errors.read(_MEGABYTE).decode(errors="replace")
        if "bad_alloc" in said or "MemoryError" in said or "length_error" in said:
            megabytes = self._limits.memory // _MEGABYTE
            return SceneError(self._path, f"reading it needs more than {megabytes} MB")
        if code in (-signal.SIGXCPU, -signal.SIGKILL):
            return SceneError(self._path, f"reading it took more than {self._limits.seconds:.3g} s")
        if code < 0:
            name = signal.Signals(-code).name
            return SceneError(
                self._path, f"OpenUSD's parser crashed on it ({name})", remedy="repair the file"
            )
        last = said.strip().splitlines()[-1:] or [f"exit status {code}"]
        return SceneError(self._path, f"OpenUSD's parser gave up on it ({last[0]})")
