"""Work in processes of their own, and JSON lines that a killed run may leave unfinished."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import threading
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

_running: set[int] = set()
"""Groups of processes that answers are being waited for."""


def answer_of(command: Sequence[str], limit: float) -> dict[str, Any]:
    """The JSON object on the last line that a command prints; with one thread.

    Args:
      limit: s; what takes longer is ended, with all that it has started.

    Raises:
      TimeoutError: it took longer.
      ValueError: it printed no such object; its exit status and the end of what it complained of.
    """
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )
    _running.add(process.pid)
    try:
        stdout, stderr = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        raise TimeoutError(f"took more than {limit:g} s") from None
    finally:
        _running.discard(process.pid)
    try:
        answer = json.loads(stdout.strip().splitlines()[-1])
    except (IndexError, ValueError):
        answer = None
    if not isinstance(answer, dict):
        raise ValueError(f"exit status {process.returncode}: {stderr.strip()[-2000:]}")
    return answer


def spawned(workers: int) -> ProcessPoolExecutor:
    """Processes that may draw: a forked one has no OpenGL context where EGL was opened before."""
    return ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))


def with_own_cores(workers: int) -> ThreadPoolExecutor:
    """Threads whose processes share out the processors: none waits for threads of another.

    A process runs where the thread that has started it may run. As many processors for each as
    there are whole ones; where there are fewer than workers, several share one. If this process is
    ended (SIGTERM), they are.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _end)
    shares: SimpleQueue[set[int]] = SimpleQueue()
    if hasattr(os, "sched_getaffinity"):
        usable = sorted(os.sched_getaffinity(0))
        for number in range(workers):
            own = usable[number : workers * (len(usable) // workers) : workers]
            shares.put(set(own or [usable[number % len(usable)]]))

    def settle() -> None:
        if not shares.empty():
            os.sched_setaffinity(0, shares.get())

    return ThreadPoolExecutor(workers, initializer=settle)


def _end(number: int, _: object) -> None:
    """Ends what was started, then this process, as the signal does by default."""
    for group in tuple(_running):
        os.killpg(group, signal.SIGKILL)
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Entries of a file of JSON lines; the last one of a trial and tool counts; none without file.

    A line that a killed run left unfinished is passed over.
    """
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        found[entry["trial"], entry["tool"]] = entry
    return list(found.values())
