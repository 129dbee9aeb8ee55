"""Time that tests bound, on machines that are busy with other work."""

from __future__ import annotations

import os
import time


class Stopwatch:
    """Runs from when it is made."""

    def __init__(self) -> None:
        self._clock, self._processor = time.monotonic(), _processor()

    @property
    def seconds(self) -> float:
        """Time on the clock, or of the processor where that is less."""
        return min(time.monotonic() - self._clock, _processor() - self._processor)


def _processor() -> float:
    """Seconds of this process and of its children that have ended."""
    return sum(os.times()[:4])
