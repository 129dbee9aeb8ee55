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
_ADDRESS_SPACE = 16 * 2**30
_WATCH = 0.02
_IF_TRUSTED = "if the file is trusted, pass trusted=True (command line: --trusted)"


@dataclasses.dataclass(frozen=True)
class Limits:
    """Bounds on reading one scene.

    Attributes:
      seconds: wall-clock time.
      memory: bytes that may become resident on top of what the process holds already. (Address
        space is bounded far above it: MuJoCo reserves more than it touches.)
    """

    seconds: float = 3.0
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
        report, excess = _read_report(read_end, pid, limits)
    finally:
        os.close(read_end)
        status = _reap(pid)
    if excess:
        raise SceneError(source, excess, remedy=_IF_TRUSTED)
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
        report = {"problem": _too_large(limits), "element": None, "remedy": _IF_TRUSTED}
    except OrbiSimError as error:
        report = {"problem": str(error), "element": None, "remedy": None}
    except BaseException as error:
        report = {"problem": f"{type(error).__name__}: {error}", "element": None, "remedy": None}
    try:
        os.write(write_end, json.dumps(report).encode()[:60000])
    finally:
        os._exit(0)


def _limit_memory(nbytes: int) -> None:
    """A last resort below the parent's watch, for a single huge allocation that is touched."""
    try:
        import resource

        limit = _resident(os.getpid(), 0) + _ADDRESS_SPACE + 8 * nbytes
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        pass  # not Linux: the bound on time still holds


def _resident(pid: int, field: int = 1) -> int:
    """Bytes that a process holds (field 1: resident, 0: address space); 0 if unknown."""
    try:
        with open(f"/proc/{pid}/statm") as statm:  # noqa: PTH123 (no Path import in a child)
            return int(statm.read().split()[field]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def _too_large(limits: Limits) -> str:
    return f"reading it needs more than {limits.memory // _MEGABYTE} MB of memory"


def _read_report(
    fd: int, pid: int, limits: Limits
) -> tuple[dict[str, str | None] | None, str | None]:
    """The child's report, and which bound it broke, if any."""
    deadline = time.monotonic() + limits.seconds
    ceiling = _resident(os.getpid()) + limits.memory
    chunks: list[bytes] = []
    while True:
        left = deadline - time.monotonic()
        if left <= 0:
            return None, f"reading it took more than {limits.seconds:.3g} s"
        if _resident(pid) > ceiling:
            return None, _too_large(limits)
        ready, _, _ = select.select([fd], [], [], min(left, _WATCH))
        if not ready:
            continue
        chunk = os.read(fd, 65536)
        if not chunk:
            break
        chunks.append(chunk)
    try:
        return json.loads(b"".join(chunks)), None
    except ValueError:
        return None, None


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
