"""Where a training stands: by steps or by wall-clock time, and what follows from it."""

from __future__ import annotations

import dataclasses
import math
import time

from orbisim_world_model.config import TrainConfig


@dataclasses.dataclass
class Clock:
    """Counts steps and seconds; a training ends when either budget is used up.

    Args:
      steps: of the whole training, or None.
      limit: wall-clock seconds of the whole training, or None.
      done: steps done already. spent: seconds spent already.
      most: seconds of training at most, where `skip` took less off the limit than was feared.
    """

    steps: int | None
    limit: float | None
    done: int = 0
    spent: float = 0.0
    most: float | None = None

    def __post_init__(self) -> None:
        self._since = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds spent on the training, earlier runs included."""
        return self.spent + time.monotonic() - self._since

    def skip(self, seconds: float) -> None:
        """Takes seconds that were no training off the budget, so that the schedule has the rest."""
        self._since += seconds
        if self.limit is not None:
            self.limit = max(self.limit - seconds, 1.0)

    @property
    def progress(self) -> float:
        """0 at the start, 1 at the end."""
        parts = [0.0]
        if self.steps is not None:
            parts.append(self.done / max(self.steps, 1))
        parts += [self.elapsed / end for end in (self.limit, self.most) if end is not None]
        return min(max(parts), 1.0)


def stage_at(config: TrainConfig, progress: float) -> tuple[int, float]:
    """Number of the stage, and progress within it, 0 to 1."""
    total = sum(stage.fraction for stage in config.stages)
    start = 0.0
    for number, stage in enumerate(config.stages):
        share = stage.fraction / total
        if progress < start + share or number == len(config.stages) - 1:
            return number, min(max((progress - start) / share, 0.0), 1.0)
        start += share
    raise AssertionError("a configuration has at least one stage")


def learning_rate(config: TrainConfig, progress: float) -> float:
    """Rises linearly over the warm-up, then falls on half a cosine to `final_rate`."""
    if progress < config.warmup:
        return config.rate * (progress + 1e-3) / (config.warmup + 1e-3)
    through = (progress - config.warmup) / (1.0 - config.warmup)
    low = config.final_rate
    return low + 0.5 * (config.rate - low) * (1.0 + math.cos(math.pi * through))
