"""Processor time of other processes, and bounds on it."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

from orbisim.files.budget import Budget, Limits, processor_time

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="the clock of another process")


@LINUX
def test_processor_time_is_that_of_the_process() -> None:
    mine = processor_time(os.getpid())
    assert mine is not None
    assert mine == pytest.approx(time.process_time(), abs=0.5)
    sleeper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        time.sleep(0.3)
        before = processor_time(sleeper.pid)
        assert before is not None
        assert before < 5.0
    finally:
        sleeper.kill()
        sleeper.wait()


def test_a_process_that_is_gone_breaks_no_bound() -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    assert Budget(gone.pid).excess(Limits()) is None


def test_bounds_grow_with_the_input_and_end_somewhere() -> None:
    limits = Limits(seconds=1.0, memory=2**20, stall=7.0)
    larger = limits.for_input_of(2**21)
    assert (larger.seconds, larger.memory, larger.stall) == (3.0, 65 * 2**20, 7.0)
    assert limits.for_input_of(2**50) == limits.largest()


@LINUX
def test_what_is_exceeded_is_said() -> None:
    budget = Budget(os.getpid())
    assert "processor time" in (budget.excess(Limits(seconds=0.0)) or "")
    assert budget.excess(Limits(seconds=10**9)) is None
    time.sleep(0.05)
    idle = Budget(os.getpid())
    idle._seen = 10**9  # as if nothing were done any more
    assert "come to a halt" in (_later(idle, Limits(seconds=10**9, stall=0.01)) or "")


def _later(budget: Budget, limits: Limits) -> str | None:
    time.sleep(0.05)
    return budget.excess(limits)
