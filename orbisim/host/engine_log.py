"""MuJoCo's warnings, which would otherwise go to standard error and to a log file."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

import mujoco


@contextlib.contextmanager
def engine_warnings(take: Callable[[str], None]) -> Iterator[None]:
    """Hands MuJoCo's warnings to a function, as one line each, while the context lasts.

    The handler is MuJoCo's own and so the process' only one: the former one comes back at the end.
    """

    def handle(message: Any) -> None:
        text = message.decode(errors="replace") if isinstance(message, bytes) else str(message)
        take(" ".join(text.split()))

    previous = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(handle)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(previous)


@contextlib.contextmanager
def without_warnings(about: str) -> Iterator[None]:
    """Keeps MuJoCo's warnings that contain a text from whoever hears the others."""
    previous = mujoco.get_mju_user_warning()

    def passed_on(text: str) -> None:
        if about in text:
            return
        if previous is None:
            sys.stderr.write(f"WARNING: {text}\n")
        else:
            previous(text)

    with engine_warnings(passed_on):
        yield


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Nothing that libraries write to the descriptor of standard error is seen meanwhile."""
    with contextlib.suppress(ValueError, OSError):
        sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def ignore(text: str) -> None:
    """Takes a warning and says nothing."""
