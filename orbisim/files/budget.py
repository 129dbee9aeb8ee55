"""How much time a child process has used, and may use.

What counts is processor time, of all of its threads: on a busy machine a child that is in order
waits long for its turn, and one that is not would hide behind that. Time on the clock is bounded
only to notice a child that does nothing at all.
"""

from __future__ import annotations

import dataclasses
import os
import time

_MEGABYTE = 2**20  # bytes
_MOST_INPUT = 2 * 2**30
"""Bytes of input beyond which bounds grow no further: an archive holds no more either."""
_TICK = 0.01
"""Processor time, s, below which a child has done nothing."""
_SLOWEST = 50.0
"""Time on the clock over processor time of a child that is in order, at most."""


@dataclasses.dataclass(frozen=True)
class Limits:
    """Bounds on reading one scene.

    Attributes:
      seconds: processor time, all threads together.
      memory: bytes that may become resident on top of what the process holds already. (Address
        space is bounded far above it: MuJoCo reserves more than it touches.)
      stall: seconds on the clock in which no processor time at all is used.
    """

    seconds: float = 4.0
    memory: int = 1024 * _MEGABYTE
    stall: float = 60.0

    def for_input_of(self, nbytes: int) -> Limits:
        """Bounds that grow with the size of the input: 1 s and 32 MB for each megabyte.

        Never to more than half of the machine's memory.
        """
        megabytes = min(nbytes, _MOST_INPUT) / _MEGABYTE
        memory = self.memory + int(32 * megabytes) * _MEGABYTE
        return dataclasses.replace(
            self,
            seconds=self.seconds + megabytes,
            memory=min(memory, max(self.memory, _half_of_all())),
        )

    def largest(self) -> Limits:
        """The bounds for the largest input that is read."""
        return self.for_input_of(_MOST_INPUT)


def _half_of_all() -> int:
    """Half of the bytes of memory that the machine has; much where that is not known."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    except (AttributeError, OSError, ValueError):
        return 2**62


class Budget:
    """Watches the time that a child process takes."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._start = self._active = time.monotonic()
        self._seen = 0.0

    def excess(self, limits: Limits) -> str | None:
        """Which bound is broken, in words; None while the child is in order."""
        now = time.monotonic()
        spent = processor_time(self._pid)
        if spent is None:  # a system that does not tell: the clock has to do
            spent = now - self._start
        if spent >= self._seen + _TICK:
            self._seen, self._active = spent, now
        if spent > limits.seconds:
            return f"reading it took more than {limits.seconds:.3g} s of processor time"
        if now - self._active > limits.stall:
            return f"reading it has come to a halt: nothing was done for {limits.stall:.3g} s"
        if now - self._start > _SLOWEST * limits.seconds + limits.stall:
            return f"reading it took more than {now - self._start:.3g} s"
        return None


def processor_time(pid: int) -> float | None:
    """Seconds of processor time that a process has used, all threads together.

    Returns None where the system does not tell (and 0 if there is no such process). The clock's
    number is that of clock_getcpuclockid(3) on Linux.
    """
    scheduled = 2
    try:
        return time.clock_gettime((~pid << 3) | scheduled)
    except ProcessLookupError:
        return 0.0
    except (AttributeError, OSError, OverflowError, ValueError):
        return _from_stat(pid)


def _from_stat(pid: int) -> float | None:
    """The same from /proc, in steps of 10 ms."""
    try:
        with open(f"/proc/{pid}/stat") as stat:  # noqa: PTH123 (no Path import in a child)
            fields = stat.read().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return None
