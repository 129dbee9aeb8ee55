"""Workers: they end with the process that made them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

_PARENT = """
import multiprocessing, signal, sys, time
from pathlib import Path
from orbisim.tasks import pool
{before}
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells let background jobs ignore it

def work(folder):
    import os
    kind = type(multiprocessing.current_process()).__name__
    (folder / "-".join([str(os.getpid()), kind])).touch()
    time.sleep(60)

if __name__ == "__main__":
    for _ in pool.run(work, [(Path(sys.argv[1]),)] * 4, 2):
        pass
"""


def gone(pid: int) -> bool:
    """Whether a process has ended; a zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def wait_until(condition, seconds: float = 60.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return bool(condition())


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("loaded", ["", "torch", "OpenGL.EGL"])
@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_parent(tmp_path: Path, kind: signal.Signals, loaded: str) -> None:
    script = tmp_path / "parent.py"
    before = f"import types; sys.modules[{loaded!r}] = types.ModuleType({loaded!r})"
    script.write_text(_PARENT.format(before=before if loaded else ""))
    folder = tmp_path / "workers"
    folder.mkdir()
    parent = subprocess.Popen([sys.executable, str(script), str(folder)], stderr=subprocess.DEVNULL)
    try:
        assert wait_until(lambda: len(list(folder.iterdir())) == 2)
        workers = {int(path.name.partition("-")[0]): path.name for path in folder.iterdir()}
        begun = "SpawnProcess" if loaded else "ForkProcess"
        assert all(name.endswith(begun) for name in workers.values())
        assert not any(map(gone, workers))
        os.kill(parent.pid, kind)
        parent.wait(60)
        assert wait_until(lambda: all(map(gone, workers)))
    finally:
        parent.kill()
        parent.wait()
