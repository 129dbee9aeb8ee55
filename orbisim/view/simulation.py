"""One world advanced by a backend, and its pace."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.errors import DivergedError, InputError
from orbisim.state import Array, State
from orbisim.view.drawing import Drawing

Policy: TypeAlias = Callable[[State], Array]
"""From a state with one world to a control [nu] or [1, nu]; `StopIteration` ends the run."""

_FORGIVEN = 0.2
"""Lag behind real time, s, beyond which it is not caught up with."""


class Simulation:
    """One world being advanced by a backend.

    Args:
      backend: with a scene loaded.
      start: where to start; None for the backend's reset.
      controls: a policy; a sequence [T, nu], after which the simulation is over; None for zeros.
      nstep: steps for which each control is held.

    Attributes:
      state: now. manual: [nu], controls that are held by hand; None for the policy's.

    Raises:
      InputError: start or controls do not fit the scene.
    """

    def __init__(
        self,
        backend: Backend,
        start: State | None = None,
        controls: npt.ArrayLike | Policy | None = None,
        nstep: int = 1,
    ) -> None:
        self._backend, self._nstep = backend, nstep
        self._start = backend.reset(1) if start is None else start
        self._check_start()
        if controls is not None and not callable(controls):
            controls = backend.check_controls(self._start, np.asarray(controls, np.float64))[0]
        self._controls = controls
        self.manual: npt.NDArray[np.float64] | None = None
        self.state: State = self._start
        self.restart()

    def _check_start(self) -> None:
        self._backend.check_state(self._start)
        if self._start.nworld != 1:
            raise InputError(
                f"the live viewer shows one world; got a state of {self._start.nworld}"
            )
        if not self._start.finite.all():
            raise InputError("the state to start from is not finite")

    def step_once(self) -> None:
        """One step, even if the controls have ended.

        Raises:
          DivergedError: the state is not finite any more.
        """
        self.advance(self.elapsed + self._backend.timestep)

    def place_joint(self, address: int, value: float) -> None:
        """Sets one number of `qpos`; velocities become zero, as nothing moved it there."""
        state = self.state.numpy()
        qpos = state.qpos.copy()
        qpos[0, address] = value
        self.state = State(state.time, qpos, np.zeros_like(state.qvel), state.act, _kept(state))

    def command(self, index: int, value: float) -> None:
        """Holds one control; the others are zero until they are set. Policies are not asked."""
        if self.manual is None:
            self.manual = np.zeros(self._backend.model.nu)
        self.manual[index] = value

    def release(self) -> None:
        """The policy, or the sequence from where it was, controls again."""
        self.manual = None

    def use(self, backend: Backend) -> None:
        """Goes on with another backend, which has the same scene; the physical state stays."""
        state = self.state.numpy()
        backend.check_state(plain := State(state.time, state.qpos, state.qvel, state.act))
        self._elapsed_before = self.elapsed
        self._backend, self.state, self._step = backend, plain, 0

    def restart(self) -> None:
        """Back to the start."""
        self._elapsed_before = 0.0
        self.state, self._step = self._start, 0
        self._policy = _as_policy(self._controls)

    @property
    def elapsed(self) -> float:
        """Simulated time since the start, s."""
        return self._elapsed_before + self._step * self._backend.timestep

    def advance(self, until: float) -> bool:
        """Steps until `elapsed` reaches `until`; whether the controls lasted.

        Raises:
          DivergedError: the state is not finite any more.
        """
        while self.elapsed < until - 1e-9:
            if self._policy is None or self.manual is not None:
                missing = round((until - self.elapsed) / self._backend.timestep)
                control = None if self.manual is None else self.manual[None]
                self._advance(control, max(1, missing))
                continue
            try:
                control = self._policy(self.state)
            except StopIteration:
                return False
            self._advance(control, self._nstep)
        return True

    def _advance(self, control: Array | None, nstep: int) -> None:
        after = self._backend.step(self.state, control, nstep)
        if not after.finite.all():
            raise DivergedError(
                f"backend {self._backend.name!r}: the state is not finite after "
                f"{self.elapsed:.4g} s; reduce the timestep or the controls",
                [0],
            )
        self.state, self._step = after, self._step + nstep

    def place(self, drawing: Drawing) -> None:
        """Moves a drawing to where the world is now."""
        host = self.state.numpy()
        memory = {name: array[0] for name, array in host.memory.items()}
        drawing.place(host.qpos[0], memory)


def _kept(state: State) -> dict[str, Array]:
    """What a state remembers that holds wherever a joint is."""
    return {n: state.memory[n] for n in ("mocap_pos", "mocap_quat") if n in state.memory}


def _as_policy(controls: Array | Policy | None) -> Policy | None:
    if controls is None or callable(controls):
        return controls
    rows: Iterator[Array] = iter(controls)
    return lambda state: next(rows)


class Pace:
    """Ties simulated time to the clock.

    Args:
      fps: frames per second.
      realtime: False for as fast as possible.

    Attributes:
      frame: s of the clock. speed: simulated time for each second of the clock.
    """

    def __init__(self, fps: float, realtime: bool) -> None:
        self.frame, self.speed, self._realtime = 1 / fps, 1.0, realtime
        self._origin = self._last = time.perf_counter()

    def start(self, elapsed: float) -> None:
        """From now on, simulated time runs along with the clock, from `elapsed`."""
        self._origin = time.perf_counter() - elapsed / self.speed

    def keep(self, elapsed: float) -> None:
        """Waits until the clock has caught up with simulated time."""
        if not self._realtime:
            return
        ahead = elapsed / self.speed - (time.perf_counter() - self._origin)
        if ahead > 0:
            time.sleep(ahead)
        elif ahead < -_FORGIVEN:
            self.start(elapsed)

    def due(self) -> bool:
        """Whether it is time for another frame."""
        now = time.perf_counter()
        if not self._realtime and now - self._last < self.frame:
            return False
        self._last = now
        return True
