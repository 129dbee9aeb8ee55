"""Until when a search may take: a value that goes down into every loop that can last."""

from __future__ import annotations

import dataclasses
import time


class TimeIsUpError(Exception):
    """A deadline has passed. No `OrbiSimError`: whoever tries one suspect after the other is not to
    take it for a failure of that suspect, and go on."""


@dataclasses.dataclass(frozen=True)
class Deadline:
    """A time on the monotonic clock, s; infinite for none."""

    at: float = float("inf")

    @classmethod
    def after(cls, seconds: float) -> Deadline:
        """So many seconds from now."""
        return cls(time.monotonic() + seconds)

    @property
    def left(self) -> float:
        """Seconds until then; negative once it has passed."""
        return self.at - time.monotonic()

    @property
    def passed(self) -> bool:
        """Whether it has."""
        return time.monotonic() > self.at

    def check(self) -> None:
        """Raises if it has passed.

        Raises:
          TimeIsUpError: it has.
        """
        if self.passed:
            raise TimeIsUpError


NEVER = Deadline()
