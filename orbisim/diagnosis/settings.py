"""How the search for missing effects goes about it."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Settings:
    """How the search goes about it.

    Attributes:
      effects: names of the effects to consider; all if None.
      most_effects: at most so many are added.
      shortlist: how many suspects of a screening are fitted by simulation.
      windows: how many windows are used to compare suspects.
      enough: residual over noise at which nothing is left to explain.
      gain: an effect must reduce the mean squared residual on check windows by this share of what
        exceeds the noise.
      certainty: ... and by so many standard errors over the windows.
      margin: information criterion by which an effect must pay.
      retune: whether declared parameters may be retuned.
      robust: Huber threshold; None for 4 with contacts, and none without.
      patience: s after which no further effect is looked for. A fit under way, the one attempt at
        several effects at once and the final fits are finished, so a search may take longer.
      seed: of the bootstrap.
    """

    effects: tuple[str, ...] | None = None
    most_effects: int = 3
    shortlist: int = 6
    windows: int = 48
    enough: float = 1.06
    gain: float = 0.02
    certainty: float = 2.0
    margin: float = 12.0
    retune: bool = True
    robust: float | None = None
    patience: float = 600.0
    seed: int = 0
