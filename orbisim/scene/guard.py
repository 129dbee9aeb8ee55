"""Runs a parser where it cannot take the process down.

MuJoCo's compiler and OpenUSD's parsers are C++ code that a hostile or broken file can crash,
stall or make allocate without bound. `guarded` runs a function in a forked child with a bound on
time and memory and reports what became of it; only when the child came through does the caller
do the same work in its own process.
"""

from __future__ import annotations

import dataclasses
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable

from orbisim.errors import OrbiSimError, SceneError

_MEGABYTE = 2**20


@dataclasses.dataclass(frozen=True)
class Limits:
    """Bounds on reading one scene.

    Attributes:
      seconds: wall-clock time.
      memory: bytes that may be allocated on top of what the process holds already.
    """

    seconds: float = 4.0
    memory: int = 1536 * _MEGABYTE

    def for_input_of(self, nbytes: int) -> Limits:
        """Bounds that grow with the size of the input: 1 s and 32 MB for each megabyte."""
        megabytes = nbytes / _MEGABYTE
        return Limits(self.seconds + megabytes, self.memory + int(32 * megabytes) * _MEGABYTE)


def guarded(work: Callable[[], object], source: str, limits: Limits) -> None:
    """Runs `work()` in a forked child and raises what went wrong there.

    Does nothing where the platform has no `fork`.

    Raises:
      SceneError: `work` raised, crashed, ran out of time or out of memory in the child.
    """
    if not hasattr(os, "fork"):
        return
    read_end, write_end = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:  # pragma: no cover (measured in the parent only)
        os.close(read_end)
        _child(work, write_end, limits)
    os.close(write_end)
    try:
        report, timed_out = _read_report(read_end, limits.seconds)
    finally:
        os.close(read_end)
        status = _reap(pid)
    if timed_out:
        raise SceneError(
            source,
            f"reading it took more than {limits.seconds:.3g} s",
            remedy="if the file is trusted, pass trusted=True (command line: --trusted)",
        )
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        raise SceneError(source, f"the parser crashed on it ({name})", remedy="repair the file")
    if report is None:
        raise SceneError(source, "the parser gave up on it without a message")
    if report:
        raise SceneError(
            source, str(report["problem"]), element=report["element"], remedy=report["remedy"]
        )


def _child(work: Callable[[], object], write_end: int, limits: Limits) -> None:
    """Runs in the child; never returns."""
    report: dict[str, str | None] = {}
    try:
        _limit_memory(limits.memory)
        signal.alarm(int(limits.seconds) + 2)  # should the parent be gone
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, 1)
        os.dup2(devnull, 2)
        work()
    except SceneError as error:
        report = {"problem": error.problem, "element": error.element, "remedy": error.remedy}
    except MemoryError:
        report = {
            "problem": f"reading it needs more than {limits.memory // _MEGABYTE} MB",
            "element": None,
            "remedy": "if the file is trusted, pass trusted=True (command line: --trusted)",
        }
    except OrbiSimError as error:
        report = {"problem": str(error), "element": None, "remedy": None}
    except BaseException as error:
        report = {"problem": f"{type(error).__name__}: {error}", "element": None, "remedy": None}
    try:
        os.write(write_end, json.dumps(report).encode()[:60000])
    finally:
        os._exit(0)


def _limit_memory(nbytes: int) -> None:
    try:
        import resource

        with open("/proc/self/statm") as statm:  # noqa: PTH123 (cheap, no Path import in a child)
            held = int(statm.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (held + nbytes, held + nbytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        pass  # not Linux: the bound on time still holds


def _read_report(fd: int, seconds: float) -> tuple[dict[str, str | None] | None, bool]:
    deadline = time.monotonic() + seconds
    chunks: list[bytes] = []
    while True:
        left = deadline - time.monotonic()
        ready, _, _ = select.select([fd], [], [], max(left, 0.0))
        if not ready:
            return None, True
        chunk = os.read(fd, 65536)
        if not chunk:
            break
        chunks.append(chunk)
    try:
        return json.loads(b"".join(chunks)), False
    except ValueError:
        return None, False


def _reap(pid: int) -> int:
    done, status = os.waitpid(pid, os.WNOHANG)
    if not done:
        for _ in range(20):  # the report is in: the child is on its way out
            time.sleep(0.002)
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                return status
        os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
    return status
