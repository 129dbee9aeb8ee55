"""What a file of samples holds, before anything is checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Contents:
    """Samples of named signals over time, as `Recording` has them, unchecked.

    Attributes:
      time: [T]. signals: [T] or [T, n] by name.
      units, metadata: what the file says of them. source: its name. notes: what was ignored.
      columns: what else the file holds, under names that are not those of signals.
      map_file: which said which column is which signal, if one did.
    """

    time: Floats
    signals: Mapping[str, Floats]
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    source: str = "recording"
    notes: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    map_file: str | None = None
