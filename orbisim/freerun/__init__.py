"""Free-running simulation of windows of recordings, many at once, on any backend."""

from orbisim.freerun.jobs import Prepared, Run
from orbisim.freerun.run import WORLDS, free_run

__all__ = ["WORLDS", "Prepared", "Run", "free_run"]
