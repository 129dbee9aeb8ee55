"""Child processes that do not outlive the process that made them."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import threading

from orbisim.host import progress

_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of <linux/prctl.h>


def die_with_parent() -> None:
    """Ends this process as soon as its parent has ended, however that ended.

    On Linux the system does it. Elsewhere, and where the parent was gone before it was asked, a
    thread does, which waits for the end of the parent (of processes of `multiprocessing` only).
    """
    with contextlib.suppress(Exception):  # not Linux
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)


def begin_work() -> None:
    """What a worker process does first.

    Ctrl-C is left to the parent, which ends its workers; no handler of the parent's is in the way
    of being ended. What takes long is left to the parent to say.
    """
    os.environ.setdefault(progress.QUIET, "1")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    die_with_parent()
