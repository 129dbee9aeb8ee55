"""State and MjData: one world in, one world out."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.state import MEMORY, State


def read_state(data: mujoco.MjData) -> State:
    """The state held in MjData, as one world."""
    memory = {name: getattr(data, name) for name in MEMORY}
    return State(
        time=np.array([data.time]),
        qpos=data.qpos[None].copy(),
        qvel=data.qvel[None].copy(),
        act=data.act[None].copy(),
        memory={name: array[None].copy() for name, array in memory.items() if array.size},
    )


def write_state(data: mujoco.MjData, state: State, world: int = 0) -> None:
    """Puts one world of a state into MjData; derived fields are not recomputed."""
    data.time = float(state.time[world])
    for name in ("qpos", "qvel", "act"):
        getattr(data, name)[:] = _host(getattr(state, name)[world])
    for name in MEMORY:
        if name in state.memory and getattr(data, name).size:
            getattr(data, name)[:] = _host(state.memory[name][world])


def acceleration_sensors(model: mujoco.MjModel) -> npt.NDArray[np.int64]:
    """Indices into `sensordata` of the sensors computed by the acceleration stage."""
    stage = int(mujoco.mjtStage.mjSTAGE_ACC)
    ranges = [
        np.arange(model.sensor_adr[i], model.sensor_adr[i] + model.sensor_dim[i])
        for i in range(model.nsensor)
        if model.sensor_needstage[i] == stage
    ]
    return np.concatenate(ranges) if ranges else np.zeros(0, np.int64)


def _host(array: Any) -> Any:
    return array.detach().cpu().numpy() if hasattr(array, "detach") else array
