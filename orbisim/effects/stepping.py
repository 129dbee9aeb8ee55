"""Steps a batch of C MuJoCo, with the hooks of effects that MuJoCo cannot express."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import mujoco.batch
import numpy as np

from orbisim.effects.base import Hook
from orbisim.effects.running import HookRunner, stage_of


def step_batch(
    model: mujoco.MjModel,
    batch: mujoco.batch.Batch,
    hooks: Sequence[Hook],
    control: Any,
    nstep: int,
    ids: Any = None,
) -> None:
    """Advances worlds by `nstep` timesteps under a constant control [nworld, nu].

    Args:
      ids: the worlds; all if None.
    """
    if not hooks:
        batch.bind("ctrl")[:] = control
        batch.step(ids, nstep)
        return
    runner = HookRunner(model, hooks)
    stage = int(stage_of(runner.derived))
    applied = {n: np.array(batch.bind(n)) for n in ("qfrc_applied", "xfrc_applied")}
    expanded = {name: batch.expand(name) for name in runner.fields}
    base = {
        name: np.repeat(getattr(model, name)[None], batch.nsim, axis=0) for name in runner.fields
    }
    for name in runner.derived:
        batch.bind(name)
    batch.bind("ctrl")[:] = control
    if runner.derived:
        batch.forward(ids, stage)
    for _ in range(nstep):
        inputs = runner.inputs(batch.bind, control, applied, base)
        batch.bind("ctrl")[:] = inputs.ctrl
        batch.bind("qfrc_applied")[:] = inputs.qfrc
        batch.bind("xfrc_applied")[:] = inputs.xfrc
        for name, values in inputs.fields.items():
            expanded[name][:] = values
        batch.step(ids, 1, stage)
    for name, values in applied.items():
        batch.bind(name)[:] = values
