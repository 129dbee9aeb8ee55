"""What is simulated, and what comes of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from orbisim.recording.bound import Bound
from orbisim.recording.initial import Starts
from orbisim.recording.windows import Rows
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """A recording with the states at its rows and its windows.

    Attributes:
      bound: the recording in the scene's order.
      states: the state at every row. windows: what to simulate.
      notes: what was assumed about them.
    """

    bound: Bound
    states: Starts
    windows: tuple[Rows, ...]
    notes: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """The simulation of one window at the recorded times.

    Attributes:
      recording: number of the recording. rows: its rows.
      time: [N], s, as recorded.
      qpos: [N, nq], qvel: [N, nv], act: [N, na]; NaN after a divergence.
      sensordata: [N, nsensordata], or None if nothing was compared or the backend has none.
      diverged: whether the simulation became non-finite.
    """

    recording: int
    rows: Rows
    time: Floats
    qpos: Floats
    qvel: Floats
    act: Floats
    sensordata: Floats | None
    diverged: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Job:
    """One window with what drives it.

    Attributes:
      recording: number of the recording. rows: its rows. prepared: the recording itself.
      ctrl: the controls. force: generalized forces that drive joints, if there are any.
    """

    recording: int
    rows: Rows
    prepared: Prepared
    ctrl: Held
    force: Held | None

    @property
    def time(self) -> Floats:
        """[N]: the recorded times, s."""
        return self.prepared.bound.time[self.rows.start : self.rows.stop]

    @property
    def duration(self) -> float:
        """From the first to the last of them, s."""
        return float(self.time[-1] - self.time[0])
