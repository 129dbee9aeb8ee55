"""What is said of work that takes longer than two seconds: a bar on a terminal, else one line."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from typing import TypeVar

T = TypeVar("T")
PATIENCE = 2.0
"""Seconds before a bar appears."""


def track(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """Yields the items, with a bar on standard error if it is a terminal and the work is long.

    Elsewhere, in a log say, one line stands for the bar.
    """
    if total is None and isinstance(items, Sized):
        total = len(items)
    if not sys.stderr.isatty():
        with patient(description):
            yield from items
        return
    from rich.console import Console
    from rich.progress import Progress

    started = time.monotonic()
    with Progress(console=Console(stderr=True), transient=True, auto_refresh=False) as bar:
        task = bar.add_task(description, total=total, visible=False)
        for item in items:
            yield item
            bar.advance(task)
            if time.monotonic() - started > PATIENCE:
                bar.update(task, visible=True, refresh=True)


QUIET = "ORBISIM_QUIET"
"""Environment variable: if it is set, `patient` says nothing."""


@contextlib.contextmanager
def patient(text: str) -> Iterator[None]:
    """Says in one line on standard error what is being done, if it takes longer than `PATIENCE`.

    For work that cannot be divided, such as compilation; also where nobody looks at a terminal.
    A process says the same only once.
    """
    if os.environ.get(QUIET) or text in _SAID:
        yield
        return
    timer = threading.Timer(PATIENCE, _say, (text,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


_SAID: set[str] = set()
"""What `patient` has said in this process: what is done again and again is named once."""


def _say(text: str) -> None:
    _SAID.add(text)
    with contextlib.suppress(ValueError, OSError):  # standard error may be closed
        print(f"{text} ...", file=sys.stderr, flush=True)


@contextlib.contextmanager
def status(description: str) -> Iterator[Callable[[str], None]]:
    """Gives a function that says what is going on, with a clock, on standard error if it is a
    terminal; elsewhere one line says that it goes on."""
    if not sys.stderr.isatty():
        with patient(description):
            yield lambda text: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None)
        yield lambda text: bar.update(task, description=f"{description}: {text}")
