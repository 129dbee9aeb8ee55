"""Entry point of the dumping process.

Reads the stage named on the command line and answers on standard output with messages of one
letter, eight bytes of length and a payload:

- `B` bytes of a further file that is about to be parsed (decimal): more time is in order;
- `S` the encoded `FlatStage`;
- `E` a `SceneError` as JSON.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbisim.errors import SceneError
from orbisim.host.children import die_with_parent

_MEGABYTE = 2**20  # bytes


class Channel:
    """Standard output, for messages only: whatever else prints goes to standard error."""

    def __init__(self) -> None:
        self._stream = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)

    def send(self, kind: bytes, payload: bytes) -> None:
        """Writes one message."""
        self._stream.write(kind + len(payload).to_bytes(8, "little") + payload)
        self._stream.flush()

    def report(self, problem: str, element: str | None = None, remedy: str | None = None) -> None:
        """Tells of an error."""
        text = {"problem": problem, "element": element, "remedy": remedy}
        self.send(b"E", json.dumps(text).encode())


class Limit:
    """The process's own bounds on memory and processor time, which grow with the input.

    Memory counts from what the process holds already: loading OpenUSD maps a gigabyte.
    """

    def __init__(self, memory: int, seconds: float) -> None:
        self._memory, self._seconds = memory + _address_space(), seconds
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        self._apply()

    def grow(self, nbytes: int) -> None:
        """Allows for `nbytes` more of input: 32 bytes of memory a byte, 1 s a megabyte."""
        self._memory += 32 * nbytes
        self._seconds += nbytes / _MEGABYTE
        self._apply()

    def _apply(self) -> None:
        _, hard_memory = resource.getrlimit(resource.RLIMIT_AS)
        _, hard_cpu = resource.getrlimit(resource.RLIMIT_CPU)
        memory, seconds = self._memory, int(self._seconds) + 1
        if hard_memory != resource.RLIM_INFINITY:
            memory = min(memory, hard_memory)
        if hard_cpu != resource.RLIM_INFINITY:
            seconds = min(seconds, hard_cpu)
        resource.setrlimit(resource.RLIMIT_AS, (memory, hard_memory))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, hard_cpu))


def _address_space() -> int:
    """Bytes of address space that the process holds, or a generous guess."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (OSError, ValueError):
        return 2 * 1024 * _MEGABYTE


def main(argv: Mapping[str, Any]) -> int:
    """Dumps one stage.

    Args:
      argv: `path`; `memory` in bytes and `seconds` that it may take; `root`, the folder that
        references are confined to, or None.
    """
    from pxr import Tf  # type: ignore[import-untyped,unused-ignore]

    from orbisim.scene.usd.dump.opening import open_stage, reason
    from orbisim.scene.usd.dump.stage import StageDumper
    from orbisim.scene.usd.wire import encode

    die_with_parent()
    path, root = str(argv["path"]), argv["root"]
    channel = Channel()
    limit = Limit(int(argv["memory"]), float(argv["seconds"]))

    def grow(nbytes: int) -> None:
        limit.grow(nbytes)
        channel.send(b"B", str(nbytes).encode())

    try:
        channel.send(b"S", encode(StageDumper(open_stage(path, grow, root), path).dump()))
    except SceneError as error:
        channel.report(error.problem, error.element, error.remedy)
    except Tf.ErrorException as error:
        channel.report(reason(str(error)), remedy="repair or re-export it")
    except UnicodeDecodeError as error:
        channel.report(f"holds text that is not UTF-8 ({error.reason})", remedy="repair the file")
    except MemoryError:
        sys.stderr.write("bad_alloc\n")
        return 1
    except Exception as error:
        channel.report(f"{type(error).__name__}: {error}")
    os._exit(0)  # OpenUSD's destructors take their time
