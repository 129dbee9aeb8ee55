"""The child that tries a file first: bounds, reports, and nothing left behind."""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene
from orbisim.errors import MissingDependencyError, SceneError, UnsupportedSceneError
from orbisim.files.budget import Limits
from orbisim.files.guard import COMPILING, READING, allow_for, guarded

SHORT = Limits(seconds=0.3)


def children() -> set[str]:
    """Process ids of this process's children, zombies too."""
    files = Path("/proc/self/task").glob("*/children")
    return {pid for file in files for pid in file.read_text().split()}


def open_files() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


@pytest.fixture(autouse=True)
def _nothing_left_behind() -> Iterator[None]:
    before, files = children(), open_files()
    yield
    assert children() <= before
    assert open_files() == files


def raising(error: BaseException):
    def work() -> None:
        raise error

    return work


def test_success_is_silent_and_leaves_no_process() -> None:
    guarded(lambda: None, "s", Limits())


def test_errors_come_through_whole() -> None:
    error = UnsupportedSceneError("file", "problem", element="e", remedy="r")
    with pytest.raises(UnsupportedSceneError) as caught:
        guarded(raising(error), "s", Limits())
    assert str(caught.value) == str(error)


def test_errors_about_the_program_are_left_to_the_caller() -> None:
    guarded(raising(MissingDependencyError("URDF", "urdf")), "s", Limits())


def test_unforeseen_errors_are_one_line() -> None:
    with pytest.raises(SceneError, match=r"^s: the reader failed on it \(KeyError: 'a b'\)$"):
        guarded(raising(KeyError("a\nb".replace("\n", " "))), "s", Limits())


def test_long_messages_are_cut() -> None:
    with pytest.raises(SceneError) as caught:
        guarded(raising(SceneError("s", "x" * 10**6, element="é" * 10**6)), "s", Limits())
    assert 1000 < len(str(caught.value)) < 3000


def test_crashes_are_contained() -> None:
    with pytest.raises(SceneError, match=r"the parser crashed on it \(SIGSEGV\)"):
        guarded(lambda: ctypes.string_at(0), "s", Limits())
    with pytest.raises(SceneError, match="SIGABRT"):
        guarded(os.abort, "s", Limits())
    with pytest.raises(SceneError, match="gave up on it without a message"):
        guarded(lambda: os._exit(0), "s", Limits())


def burn(seconds: float) -> None:
    """Uses processor time."""
    until = time.process_time() + seconds
    while time.process_time() < until:
        pass


def test_processor_time_is_bounded() -> None:
    start = time.process_time()
    with pytest.raises(
        SceneError, match=r"took more than 0\.3 s of processor time; if the file is"
    ):
        guarded(lambda: burn(60), "s", SHORT)
    assert time.process_time() - start < 10.0


def test_processor_time_of_all_threads_counts() -> None:
    """NumPy's product of matrices runs without Python's lock."""

    def work() -> None:
        matrix = np.ones((300, 300))
        threads = [threading.Thread(target=lambda: [matrix @ matrix for _ in range(10**6)])]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    with pytest.raises(SceneError, match="processor time"):
        guarded(work, "s", SHORT)


def test_waiting_is_no_crime() -> None:
    """A child that sleeps longer than it may compute: as if the machine were busy."""
    guarded(lambda: time.sleep(1.0), "s", Limits(seconds=0.2))


def test_a_child_that_does_nothing_is_ended() -> None:
    with pytest.raises(SceneError, match=r"has come to a halt: nothing was done for 0\.5 s"):
        guarded(lambda: time.sleep(60), "s", Limits(stall=0.5))


def test_memory_is_bounded() -> None:
    def work() -> None:
        held = []
        while True:
            held.append(b"x" * 2**22)

    with pytest.raises(SceneError, match=r"needs more than 64 MB of memory"):
        guarded(work, "s", Limits(memory=64 * 2**20))


def test_bounds_move_with_files_that_are_opened() -> None:
    def work() -> None:
        allow_for(2 * 2**20)
        burn(0.6)

    guarded(work, "s", SHORT)
    allow_for(2**40)  # outside nothing happens


def test_a_signal_handler_of_the_program_does_not_reach_the_child() -> None:
    before = signal.signal(signal.SIGALRM, lambda *_: None)
    try:
        with pytest.raises(SceneError, match="SIGALRM"):
            guarded(lambda: os.kill(os.getpid(), signal.SIGALRM), "s", Limits())
    finally:
        signal.signal(signal.SIGALRM, before)


def test_a_child_reaped_by_somebody_else() -> None:
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        guarded(lambda: None, "s", Limits())
    finally:
        signal.signal(signal.SIGCHLD, before)


def test_a_process_forked_meanwhile_does_not_delay_the_report(tmp_path: Path) -> None:
    """It holds the pipe's other end open."""
    number = tmp_path / "pid"

    def work() -> None:
        pid = os.fork()
        if pid == 0:
            time.sleep(120)
            os._exit(0)
        number.write_text(str(pid))

    start = time.monotonic()
    guarded(work, "s", Limits())
    assert time.monotonic() - start < 100
    os.kill(int(number.read_text()), signal.SIGKILL)


def test_nobody_compiles_while_it_forks() -> None:
    COMPILING.acquire()
    timer = threading.Timer(0.3, COMPILING.release)
    timer.start()
    start = time.monotonic()
    guarded(lambda: COMPILING.acquire(timeout=1) or os._exit(1), "s", Limits())
    assert time.monotonic() - start > 0.2


def test_no_fork_while_another_thread_reads() -> None:
    """What it imports at that moment would stay half imported in the child."""
    holds, done = threading.Event(), threading.Event()

    def read() -> None:
        with READING:
            holds.set()
            time.sleep(0.3)
            done.set()

    threading.Thread(target=read).start()
    holds.wait()
    guarded(lambda: None, "s", Limits())
    assert done.is_set()


def test_threads_load_at_the_same_time(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    failures: list[BaseException] = []

    def load() -> None:
        try:
            for _ in range(5):
                load_scene(path)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=load) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


def test_many_open_files() -> None:
    """The pipe's number may be above what select() takes."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 1200:
        pytest.skip("this system allows few open files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (1200, hard))
    held = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    try:
        guarded(lambda: None, "s", Limits())
    finally:
        for fd in held:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_no_process_to_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    def fork() -> int:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", fork)
    with pytest.raises(SceneError, match=r"no process can be started .*Resource temporarily"):
        guarded(lambda: None, "s", Limits())
