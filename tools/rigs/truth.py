"""Steps the truth: plain MuJoCo with a fine time step, laws in its callback, commands by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from rigs.law import Floats, Law
from rigs.machines import Machine

Controller = Callable[[float, Floats, Floats], Floats]
"""The command [nu or nv] from time, and positions and velocities as the controller reads them."""


class Diverged(Exception):
    """The truth blew up."""


@dataclasses.dataclass(frozen=True)
class Stepping:
    """step: s. integrator: `implicitfast` or `rk4`."""

    step: float
    integrator: str


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What happened, at every fine time step.

    Attributes:
      time: [K]. qpos [K, nq], qvel [K, nv]: as encoders on the machine would see them, exactly.
      body: [K, nq] the model's own state. rate: [K, nv] likewise.
      sent: [K, m] the command that was last sent. drive: [K, nv] force of the actuators at the
        joints, or the torques that were applied.
    """

    time: Floats
    qpos: Floats
    qvel: Floats
    body: Floats
    rate: Floats
    sent: Floats
    drive: Floats


def in_order(laws: Sequence[Law]) -> list[Law]:
    """What acts in the place of an actuator last: it has the gain and the limits, and gets the
    commands, that others have changed."""
    return sorted(laws, key=lambda one: one.instead)


def compiled(text: str, stepping: Stepping, laws: Sequence[Law]) -> mujoco.MjModel:
    """The truth's model: the declared one with a fine step and numbers that laws change."""
    spec = mujoco.MjSpec.from_string(text)
    for body in spec.bodies[1:]:
        body.simple = 0  # its inertia may become another
    model = spec.compile()
    model.body_sameframe[:] = 0
    model.opt.timestep = stepping.step
    kinds = {"rk4": mujoco.mjtIntegrator.mjINT_RK4}
    model.opt.integrator = int(
        kinds.get(stepping.integrator, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    )
    # commands are limited here, before what drives do to them
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    for law in in_order(laws):
        law.tune(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


class Truth:
    """A machine with laws."""

    def __init__(
        self, machine: Machine, text: str, stepping: Stepping, laws: Sequence[Law]
    ) -> None:
        self.machine, self.laws = machine, tuple(laws)
        self._made_of = text, stepping
        self.model = compiled(text, stepping, laws)
        self.applied = machine.drive == "applied"
        self.size = self.model.nv if self.applied else self.model.nu
        limited = self.model.actuator_ctrllimited.astype(bool)
        self._low = np.where(limited, self.model.actuator_ctrlrange[:, 0], -np.inf)
        self._high = np.where(limited, self.model.actuator_ctrlrange[:, 1], np.inf)

    def having(self, laws: Sequence[Law]) -> Truth:
        """The same machine with other laws."""
        return Truth(self.machine, *self._made_of, laws)

    def run(
        self,
        qpos: Floats,
        qvel: Floats,
        duration: float,
        controller: Controller,
        ticks: Floats,
        late: float,
        begin: float = 0.0,
        fresh: bool = True,
    ) -> Run:
        """Moves the machine.

        Args:
          ticks: times at which the controller reads and sends. late: s until a command arrives.
          begin: time at the start, s. fresh: whether laws forget what they did before.

        Raises:
          Diverged: the state is no longer finite, or fast beyond reason.
        """
        model, data = self.model, mujoco.MjData(self.model)
        data.qpos[:], data.qvel[:], data.time = qpos, qvel, begin
        mujoco.mj_forward(model, data)
        for law in self.laws if fresh else ():
            law.begin(model, data)
        count = round(duration / model.opt.timestep) + 1
        rows: list[tuple[Floats, ...]] = []
        times: list[float] = []
        sent, arrived = np.zeros(self.size), np.zeros(self.size)
        waiting: list[tuple[float, Floats]] = []
        tick = 0
        mujoco.set_mjcb_passive(self._passive)
        try:
            for _ in range(count):
                now = float(data.time)
                seen, rate = data.qpos.copy(), data.qvel.copy()
                for law in self.laws:
                    law.shown(seen, rate)
                if tick < len(ticks) and now >= ticks[tick] - 1e-9:
                    tick += 1
                    sent = self._limited(controller(now, seen, rate))
                    waiting.append((now + late, sent))
                while waiting and waiting[0][0] <= now + 1e-9:
                    arrived = waiting.pop(0)[1]
                self._drive(data, arrived, now)
                state = (seen, rate, data.qpos.copy(), data.qvel.copy(), sent)
                mujoco.mj_step(model, data)
                for law in self.laws:
                    law.advance(model, data)
                drive = data.qfrc_applied if self.applied else data.qfrc_actuator
                rows.append((*state, drive.copy()))
                times.append(now)
        finally:
            mujoco.set_mjcb_passive(None)
        self._check(data)
        return Run(np.array(times), *(np.array(column) for column in zip(*rows, strict=True)))

    def _limited(self, command: Floats) -> Floats:
        return command if self.applied else np.clip(command, self._low, self._high)

    def _drive(self, data: mujoco.MjData, arrived: Floats, now: float) -> None:
        given = arrived.copy()
        for law in in_order(self.laws):
            law.command(now, given)
        if self.applied:
            data.qfrc_applied[:] = given
        else:
            data.ctrl[:] = given

    def _passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for law in self.laws:
            law.passive(model, data)

    def _check(self, data: mujoco.MjData) -> None:
        bad = [w for w in (5, 6, 7) if data.warning[w].number] if len(data.warning) > 7 else []
        if bad or not np.isfinite(data.qpos).all() or np.abs(data.qvel).max() > 500:
            raise Diverged(f"the truth of {self.machine.name} blew up")
