"""`--processor-times FILE`: what each test costs, whatever else the machine does meanwhile."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

_TIMES: dict[str, dict[str, float]] = defaultdict(dict)
"""Seconds of processor time by test and phase (setup, call, teardown), of all workers."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--processor-times",
        type=Path,
        metavar="FILE",
        help="write the seconds of processor time that each test took to FILE (JSON)",
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    item.stash[_SINCE] = _processor()
    return (yield)


_SINCE = pytest.StashKey[float]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    report = yield
    now = _processor()
    report.processor_seconds = now - item.stash[_SINCE]  # travels from a worker with the report
    item.stash[_SINCE] = now
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _TIMES[report.nodeid][report.when] = report.processor_seconds


def pytest_sessionfinish(session: pytest.Session) -> None:
    path = session.config.getoption("--processor-times")
    if path and not hasattr(session.config, "workerinput"):
        slowest = sorted(_TIMES.items(), key=lambda one: -sum(one[1].values()))
        path.write_text(json.dumps(dict(slowest), indent=1) + "\n")


def _processor() -> float:
    """Seconds of this process, its threads, and its children that have ended."""
    return sum(os.times()[:4])
