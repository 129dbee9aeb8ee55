"""Steps a batch of C MuJoCo, with the hooks of effects that MuJoCo cannot express."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import mujoco.batch
import numpy as np

from orbisim.effects.base import Hook
from orbisim.effects.lateness import Floats, kept_late
from orbisim.effects.running import HookRunner, stage_of


class BatchStepper:
    """Advances the worlds of a batch, hooks at every timestep.

    What hooks read and write is looked up once: with few worlds, that takes longer than a timestep.

    Args:
      model: of the batch. batch: the worlds. hooks: what to apply.
    """

    def __init__(
        self, model: mujoco.MjModel, batch: mujoco.batch.Batch, hooks: Sequence[Hook]
    ) -> None:
        self._batch, self._ctrl = batch, batch.bind("ctrl")
        self._runner = HookRunner(model, hooks) if hooks else None
        if self._runner is None:
            return
        self._stage = int(stage_of(self._runner.derived))
        self._by_control = self._stage == int(mujoco.mjtStage.mjSTAGE_ACC)
        self._known = self._stage == _NOTHING
        self._expanded = {name: batch.expand(name) for name in self._runner.fields}
        self._base = {
            name: np.repeat(getattr(model, name)[None], batch.nsim, axis=0)
            for name in self._runner.fields
        }
        self._pushed = {name: batch.bind(name) for name in ("qfrc_applied", "xfrc_applied")}
        names = ("time", "qpos", "qvel", *self._runner.derived)
        self._read = {name: batch.bind(name) for name in names}

    def step(self, control: Any, nstep: int, ids: Any = None, more: bool = False) -> None:
        """Advances worlds by `nstep` timesteps under a constant control [nworld, nu].

        What hooks read is computed at the end of a timestep for the next one, which a persistent
        batch then goes on from: to compute it apart takes as long as half a timestep.

        Args:
          ids: the worlds, as increasing numbers; all if None.
          more: whether further calls follow, of the same worlds or some of them, before which
            nothing but applied forces and timesteps is changed.
        """
        batch, runner = self._batch, self._runner
        if ids is not None:
            ids = np.asarray(ids, np.int32)
        if runner is None:
            self._ctrl[:] = control
            batch.step(ids, nstep)
            return
        applied = {name: values.copy() for name, values in self._pushed.items()}
        self._ctrl[:] = control
        if not self._known:
            batch.forward(ids, self._stage)
        ends = self._stage if more and not self._by_control else _NOTHING
        for number in range(nstep):
            inputs = runner.inputs(self._read.__getitem__, control, applied, self._base)
            self._ctrl[:] = inputs.ctrl
            self._pushed["qfrc_applied"][:] = inputs.qfrc
            self._pushed["xfrc_applied"][:] = inputs.xfrc
            for name, values in inputs.fields.items():
                self._expanded[name][:] = values
            batch.step(ids, 1, self._stage if number + 1 < nstep else ends)
        self._known = ends == self._stage
        for name, values in applied.items():
            self._pushed[name][:] = values


_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)


class Timesteps:
    """Timesteps of the worlds of a batch, which may be others than the model's own: drives are as
    late in them as in these.

    Args:
      model: of the batch. batch: the worlds.
    """

    def __init__(self, model: mujoco.MjModel, batch: mujoco.batch.Batch) -> None:
        self._model, self._timestep = model, batch.expand("opt.timestep")
        known = kept_late(model, np.array([model.opt.timestep]))
        self._expanded = {name: batch.expand(name) for name in known}

    def set(self, steps: Floats) -> None:
        """Of each world [nworld], s."""
        self._timestep[:] = steps.reshape(self._timestep.shape)
        if self._expanded:
            for name, values in kept_late(self._model, steps).items():
                self._expanded[name][:] = values


def step_batch(
    model: mujoco.MjModel,
    batch: mujoco.batch.Batch,
    hooks: Sequence[Hook],
    control: Any,
    nstep: int,
    ids: Any = None,
) -> None:
    """Advances worlds once (see `BatchStepper.step`)."""
    BatchStepper(model, batch, hooks).step(control, nstep, ids)
