"""Runs a command while other processes keep every core busy, and says how long it took.

    python tools/busy.py --processes 10 -- make test

For `make test` on a machine that does something else: a test that depends on the clock fails here.
Ends with the command's exit status.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import subprocess
import sys
import time
from collections.abc import Iterator


@contextlib.contextmanager
def busy(processes: int) -> Iterator[None]:
    """Keeps that many processes computing."""
    others = [multiprocessing.Process(target=compute, daemon=True) for _ in range(processes)]
    for process in others:
        process.start()
    try:
        yield
    finally:
        for process in others:
            process.terminate()
            process.join()


def compute() -> None:
    """Computes until it is terminated."""
    while True:
        sum(range(1_000_000))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--processes", type=int, default=10, help="how many, 10 by default")
    parser.add_argument("command", nargs="+", help="what to run; put -- before it")
    given = parser.parse_args()
    began = time.monotonic()
    with busy(given.processes):
        status = subprocess.run(given.command, check=False).returncode
    took = time.monotonic() - began
    print(f"{took:.0f} s beside {given.processes} busy processes, exit status {status}")
    return status


if __name__ == "__main__":
    sys.exit(main())
