"""Answers of other processes, and what is left of lines."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from processes import answer_of, read_lines, with_own_cores


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_the_last_line_is_the_answer() -> None:
    said = "import json, os; print('first'); n = os.environ['OMP_NUM_THREADS']"
    said += "; print(json.dumps({'n': n}))"
    assert answer_of(python(said), 120.0) == {"n": "1"}


@pytest.mark.parametrize("code", ["raise SystemExit('lost')", "print(3); raise SystemExit('lost')"])
def test_without_an_answer_the_complaint_is_told(code: str) -> None:
    with pytest.raises(ValueError, match="exit status 1: lost"):
        answer_of(python(code), 120.0)


def test_what_takes_too_long_is_ended_with_what_it_started(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    late = f"import time, pathlib; time.sleep(3); pathlib.Path({str(mark)!r}).touch()"
    started = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {late!r}])"
    with pytest.raises(TimeoutError, match="more than 1 s"):
        answer_of(python(started), 1.0)
    with pytest.raises(TimeoutError):
        answer_of(python("import time; time.sleep(9)"), 3.5)
    assert not mark.exists()


def test_unfinished_lines_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    assert read_lines(path) == []
    one, two = (json.dumps({"trial": "a", "tool": "x", "n": n}) for n in (1, 2))
    path.write_text(f"{one}\n{two}\n{one[:9]}")
    assert read_lines(path) == [{"trial": "a", "tool": "x", "n": 2}]


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="no way to choose processors")
@pytest.mark.parametrize("workers", [1, 2, 3])
def test_processes_share_out_the_processors(workers: int) -> None:
    code = "import json, os; print(json.dumps({'own': sorted(os.sched_getaffinity(0))}))"
    together = threading.Barrier(workers)

    def asked(_: int) -> list[int]:
        together.wait(60.0)  # each by a thread of its own
        own: list[int] = answer_of(python(code), 60.0)["own"]
        return own

    usable = os.sched_getaffinity(0)
    with with_own_cores(workers) as pool:
        found = list(pool.map(asked, range(workers)))
    assert os.sched_getaffinity(0) == usable
    each = max(1, len(usable) // workers)
    assert all(len(own) == each and usable.issuperset(own) for own in found)
    if workers <= len(usable):
        assert len({core for own in found for core in own}) == workers * each


def test_what_was_started_ends_with_the_run(tmp_path: Path) -> None:
    mark, begun = tmp_path / "mark", tmp_path / "begun"
    late = f"import time, pathlib; pathlib.Path({str(begun)!r}).touch(); time.sleep(3)"
    late += f"; pathlib.Path({str(mark)!r}).touch()"
    tools = str(Path(__file__).resolve().parents[2] / "tools")
    code = f"import sys; sys.path.insert(0, {tools!r}); import processes\n"
    code += "with processes.with_own_cores(1) as pool:\n"
    code += f"    pool.submit(processes.answer_of, {python(late)!r}, 60.0)"
    process = subprocess.Popen(python(code))
    for _ in range(600):
        if begun.exists():
            break
        time.sleep(0.05)
    process.terminate()
    assert process.wait(10.0) == -signal.SIGTERM
    time.sleep(3.5)
    assert begun.exists() and not mark.exists()
