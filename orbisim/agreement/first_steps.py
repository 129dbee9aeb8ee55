"""Watches an engine's steps after its state was set."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt

from orbisim.agreement.blame import blame
from orbisim.agreement.judge import PERSISTS, Fault, StepJudge, describe
from orbisim.backend import Backend
from orbisim.errors import DivergedError, EngineError, OrbiSimError
from orbisim.state import State

Floats = npt.NDArray[np.float64]


class EngineWarning(UserWarning):
    """An engine's steps are not C MuJoCo's."""


class FirstSteps:
    """Watches the steps of one world after its state was set: the first five, then 8, 16, 32 ...

    A step that looks wrong is followed by checks of the next ones until they persist or not. What
    stands still or is lost raises; what moves otherwise than C MuJoCo's warns, once.
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._judge: StepJudge | None = None
        self._count = 0
        self._row: list[str] = []
        self._warned = False

    def restart(self, *, reloaded: bool = False) -> None:
        """The state was set by someone else; with `reloaded`, the model changed as well."""
        self._count, self._row = 0, []
        if reloaded:
            self._judge = None

    def due(self) -> bool:
        """Whether the next step is to be checked; counts it."""
        self._count += 1
        return self._count <= PERSISTS or not self._count & (self._count - 1) or bool(self._row)

    def check(self, before: State, control: Floats, nstep: int, after: State) -> None:
        """Checks one step of one world.

        Raises:
          EngineError: the engine has stood still for `PERSISTS` checked steps.
          DivergedError: C MuJoCo diverges in this step.
        """
        fault = self._fault(before, control, nstep, after)
        if fault is None:
            self._row = []
            return
        self._row.append(fault.kind)
        if fault.kind != "lost" and len(self._row) < PERSISTS:
            return
        found = blame(self._backend.scene.model, before, control, fault.dof)
        text = describe(self._backend, fault, found, nstep)
        if fault.kind == "lost":
            raise DivergedError(text, [0])
        if set(self._row[-PERSISTS:]) == {"still"}:
            raise EngineError(text)
        if not self._warned:
            warnings.warn(text, EngineWarning, stacklevel=5)
        self._warned, self._row = True, []

    def _fault(self, before: State, control: Floats, nstep: int, after: State) -> Fault | None:
        if self._judge is None:
            self._judge = StepJudge(self._backend.scene)
        try:
            return self._judge.faults(before, control, nstep, after).get(0)
        except OrbiSimError:  # C MuJoCo cannot say (its memory is full)
            return None
