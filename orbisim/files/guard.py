"""Runs a parser where it cannot take the process down.

MuJoCo's compiler and OpenUSD's parsers are C++ code that a hostile or broken file can crash,
stall or make allocate without bound. `guarded` runs a function in a forked child with a bound on
processor time and memory and reports what became of it; only when the child came through does the
caller do the same work in its own process.

The child writes lines of JSON to a pipe: `{"opened": bytes}` for each file that a reader has
checked and goes on to parse (see `allow_for`), which moves the bounds, and one last line that
says how it ended.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import select
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

from orbisim import errors
from orbisim.errors import OrbiSimError, SceneError
from orbisim.files.budget import Budget, Limits
from orbisim.host.children import die_with_parent

_MEGABYTE = 2**20  # bytes
_ADDRESS_SPACE = 16 * 2**30
"""Bytes that a child may map beyond what is resident: MuJoCo reserves arenas that it hardly
touches."""
_WATCH = 0.01
"""Seconds between two looks at what the child uses."""
_PATIENCE = 0.5
"""Seconds that a child may take to end after it has reported."""
_MOST_TEXT = 1000
"""Characters of an error message: a line that can be read."""
_IF_TRUSTED = "if the file is trusted, pass trusted=True (command line: --trusted)"

FAILED = "the reader failed on it"
"""Starts the problem where a reader raised something other than a `SceneError`."""

COMPILING = threading.Lock()
"""Held by a thread while it is inside MuJoCo's compiler, or forks."""

READING = threading.RLock()
"""Held by a thread while it reads a scene in this process, or forks: a reader may import a module
when it first needs it, and the lock of a module that is half imported stays locked in a child."""

_report_to: int | None = None
"""In a guarded child: the pipe to the parent."""


def allow_for(nbytes: int) -> None:
    """Readers call this for each file that they are about to parse and whose header is sound.

    Within `guarded`, the bounds grow with it; elsewhere nothing happens.
    """
    if _report_to is not None:
        _send(_report_to, {"opened": nbytes})


def opened(path: str | os.PathLike[str]) -> None:
    """Readers call this for each file besides the first that they read or let MuJoCo read.

    Within `guarded`, the bounds grow with its size, and the caller is told its name.
    """
    if _report_to is not None:
        _send(_report_to, {"opened": os.stat(path).st_size, "file": os.fspath(path)})  # noqa: PTH116


def guarded(work: Callable[[], object], source: str, limits: Limits) -> tuple[str, ...]:
    """Runs `work()` in a forked child and raises what went wrong there.

    Does nothing where the platform has no `fork`. An error that is about the program rather than
    the file (a missing dependency, a wrong option) is left to the caller, who will meet it when
    doing the work again.

    Returns:
      The names of the files that were reported by `opened`.

    Raises:
      SceneError: `work` raised, crashed, ran out of time or out of memory in the child.
    """
    if not hasattr(os, "fork"):
        return ()
    read_end, write_end = os.pipe()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):  # none, closed or broken
            stream.flush()
    try:
        pid = _fork()
    except OSError as error:
        os.close(read_end)
        os.close(write_end)
        problem = f"no process can be started to try it in: {error.strerror}"
        raise SceneError(source, problem, remedy=_IF_TRUSTED) from None
    if pid == 0:  # pragma: no cover (measured in the parent only)
        os.close(read_end)
        _child(work, write_end, limits)
    report = None
    watch = _Watch(pid, limits)
    try:
        os.close(write_end)
        report = watch.report(read_end)
    except BaseException:
        watch.excess = "interrupted"
        raise
    finally:
        os.close(read_end)
        status = _reap(pid, patience=0.0 if watch.excess else _PATIENCE)
    if watch.excess:
        raise SceneError(source, watch.excess, remedy=_IF_TRUSTED)
    if report is None and os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        raise SceneError(source, f"the parser crashed on it ({name})", remedy="repair the file")
    if report is None:
        raise SceneError(source, "the parser gave up on it without a message")
    if report.get("problem"):
        raise _rebuilt(report, source)
    return tuple(watch.files)


def _fork() -> int:
    """Forks while no other thread reads or compiles: its locks would stay locked in the child."""
    with READING, COMPILING, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python's, about such locks
        return os.fork()


# ---- in the child ------------------------------------------------------------------------------


def _child(work: Callable[[], object], write_end: int, limits: Limits) -> None:
    """Runs in the child; never returns."""
    global _report_to
    report: dict[str, Any] = {}
    try:
        _report_to = write_end
        _limit_memory(limits.memory)
        _die_alone(limits)
        devnull = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(devnull, stream)
        work()
    except SceneError as error:
        report = {
            "kind": type(error).__name__,
            "source": _short(error.source),
            "problem": _short(error.problem) or "refused",
            "element": _short(error.element),
            "remedy": _short(error.remedy),
        }
    except MemoryError:
        report = {"problem": _too_large(limits), "remedy": _IF_TRUSTED}
    except OrbiSimError:
        report = {}  # about the program, not the file
    except BaseException as error:
        report = {"problem": _short(f"{FAILED} ({type(error).__name__}: {error})")}
    try:
        _send(write_end, {"done": report})
    finally:
        os._exit(0)


def _die_alone(limits: Limits) -> None:
    """Ends the child should the parent be gone; no handler of the parent's gets in the way."""
    faulthandler.disable()  # a crash is reported by the parent, in one line
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    _limit_processor(int(limits.largest().seconds) + 2)
    die_with_parent()


def _limit_processor(seconds: int) -> None:
    """A last resort, should nobody watch: processor time of all threads, and the clock."""
    signal.alarm(10 * seconds)
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))


def _limit_memory(nbytes: int) -> None:
    """A last resort below the parent's watch, for a single huge allocation that is touched."""
    try:
        import resource

        limit = _resident(os.getpid(), 0) + _ADDRESS_SPACE + 8 * nbytes
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        pass  # not Linux: the bound on time still holds


def _send(fd: int, message: dict[str, Any]) -> None:
    data = json.dumps(message).encode() + b"\n"
    while data:
        data = data[os.write(fd, data) :]


def _short(text: str | None) -> str | None:
    return text if text is None or len(text) <= _MOST_TEXT else text[:_MOST_TEXT] + " ..."


# ---- in the parent -----------------------------------------------------------------------------


class _Watch:
    """Waits for a child's last line, and for it to break a bound."""

    def __init__(self, pid: int, limits: Limits) -> None:
        self._pid, self._base, self._limits = pid, limits, limits
        self._budget = Budget(pid)
        self._held = _resident(os.getpid())
        self._opened = 0
        self.files: dict[str, None] = {}
        self.excess: str | None = None

    def report(self, fd: int) -> dict[str, Any] | None:
        """How the child says it ended; None if it said nothing.

        Ends at the child's last line, or with the child: the end of the pipe may be held open by
        a process that another thread forked meanwhile.
        """
        poll = select.poll()
        poll.register(fd, select.POLLIN)
        received = b""
        while self.excess is None:
            if not poll.poll(_WATCH * 1000):
                if _ended(self._pid) and not poll.poll(0):
                    return None
                self._check()
                continue
            chunk = os.read(fd, 65536)
            if not chunk:
                return None
            *lines, received = (received + chunk).split(b"\n")
            for line in lines:
                message = _decoded(line)
                if "done" in message:
                    return dict(message["done"])
                self._opened += int(message.get("opened", 0))
                if "file" in message:
                    self.files[str(message["file"])] = None
                self._limits = self._base.for_input_of(self._opened)
            self._check()
        return None

    def _check(self) -> None:
        self.excess = self._budget.excess(self._limits)
        if self.excess is None and _resident(self._pid) > self._held + self._limits.memory:
            self.excess = _too_large(self._limits)


def _decoded(line: bytes) -> dict[str, Any]:
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _resident(pid: int, field: int = 1) -> int:
    """Bytes that a process holds (field 1: resident, 0: address space); 0 if unknown."""
    try:
        with open(f"/proc/{pid}/statm") as statm:  # noqa: PTH123 (no Path import in a child)
            return int(statm.read().split()[field]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def _too_large(limits: Limits) -> str:
    return f"reading it needs more than {limits.memory // _MEGABYTE} MB of memory"


def _ended(pid: int) -> bool:
    """Whether a child is over, without taking its status."""
    try:
        return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return True


def _reap(pid: int, patience: float) -> int:
    """Takes the status of a child; ends it if it has not ended by itself in `patience` seconds."""
    deadline = time.monotonic() + patience
    try:
        while time.monotonic() < deadline:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                return status
            time.sleep(0.001)
        os.kill(pid, signal.SIGKILL)
        return os.waitpid(pid, 0)[1]
    except (ChildProcessError, ProcessLookupError):  # somebody else took it
        return 0


def _rebuilt(report: dict[str, Any], source: str) -> SceneError:
    kind = getattr(errors, str(report.get("kind")), SceneError)
    if not (isinstance(kind, type) and issubclass(kind, SceneError)):
        kind = SceneError
    return kind(
        report.get("source") or source,
        str(report["problem"]),
        element=report.get("element"),
        remedy=report.get("remedy"),
    )
