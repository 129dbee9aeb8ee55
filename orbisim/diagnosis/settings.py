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
      retune: whether declared parameters may be retuned.
      patience: s that a diagnosis may take; it then ends with the best that it has.
      seed: of the bootstrap.
    """

    effects: tuple[str, ...] | None = None
    most_effects: int = 12
    shortlist: int = 6
    windows: int = 48
    enough: float = 1.06
    retune: bool = True
    patience: float = 600.0
    seed: int = 0
