"""Recordings of simulated trajectories, with the imperfections of measured ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.recording import names
from orbisim.recording import quaternions as quat
from orbisim.recording.actuators import actuators
from orbisim.recording.interpolation import Between, linear, positions
from orbisim.recording.joints import joints
from orbisim.recording.recording import Recording
from orbisim.recording.signal_units import unit_of
from orbisim.scene import Scene
from orbisim.trajectory import Trajectory

Floats = npt.NDArray[np.float64]
Amounts = float | Mapping[str, float]


def capture(
    scene: Scene,
    trajectory: Trajectory,
    *,
    world: int = 0,
    rate: float | None = None,
    velocities: bool = True,
    bodies: Iterable[str] = (),
    noise: Amounts = 0.0,
    resolution: Amounts = 0.0,
    seed: int = 0,
    source: str = "trajectory",
) -> Recording:
    """Records one world of a trajectory.

    Args:
      scene: the scene that was simulated.
      trajectory: as a backend's `rollout` returns it; its steps must be equally long.
      world: which world.
      rate: samples per second; a sample at every step if None. Between steps, states are
        interpolated (see `interpolation`) and controls are those in force.
      velocities: whether joint velocities are recorded.
      bodies: names of bodies whose pose is recorded too.
      noise: standard deviation of white Gaussian noise; one number for all joint positions, or
        numbers by signal or kind (`{"qpos": 1e-3, "qvel/elbow": 0.1}`). Orientations are turned by
        a random rotation vector with this standard deviation about each axis.
      resolution: rounding to multiples, given like `noise`; not for orientations.
      seed: of the noise.
      source: name of the recording.

    Raises:
      InputError: there is no such world or body, or a noise or resolution names no signal.
    """
    if not 0 <= world < trajectory.nworld:
        raise InputError(f"world {world} is not among the trajectory's {trajectory.nworld}")
    taken = _Samples(scene.model, trajectory, world, rate)
    signals = taken.joints(velocities) | taken.controls() | taken.sensors() | taken.poses(bodies)
    rng = np.random.default_rng(seed)
    _each(signals, noise, "noise", lambda name, v, a: _noisy(name, v, a, rng))
    _each(signals, resolution, "resolution", _rounded)
    units = {name: unit_of(name, scene.model) for name in signals}
    known = {name: unit for name, unit in units.items() if unit is not None}
    return Recording(taken.time, signals, units=known, source=source)


class _Samples:
    """The states of one world at the sample times."""

    def __init__(
        self, model: mujoco.MjModel, trajectory: Trajectory, world: int, rate: float | None
    ) -> None:
        self.model = model
        nodes = {
            name: _host(trajectory.with_initial(name))[world] for name in ("time", "qpos", "qvel")
        }
        start, count = float(nodes["time"][0]), trajectory.nstep
        step = (float(nodes["time"][-1]) - start) / max(count, 1)
        interval = step if rate is None else 1.0 / rate
        total = int(np.floor(count * step / interval + 1e-6)) + 1
        offsets = np.arange(total) * interval
        self.time = np.asarray(start + offsets, np.float64)
        self._place = Between(np.asarray(offsets / step if step else offsets, np.float64))
        low, high = self._place.base, np.minimum(self._place.base + 1, count)
        qpos, qvel = nodes["qpos"], nodes["qvel"]
        before, after = (qpos[low], qvel[low]), (qpos[high], qvel[high])
        self.qpos = positions(model, before, after, self._place.part, step)
        self.qvel = linear(qvel[low], qvel[high], self._place.part)
        self._held = np.minimum(low + (self._place.part == 1), count - 1)
        self._control = _host(trajectory.control)[world]
        self._sensors = trajectory.sensordata
        self._world = world

    def joints(self, velocities: bool) -> dict[str, Floats]:
        every = joints(self.model)
        if not all(joint.name for joint in every):
            return {"qpos": self.qpos} | ({"qvel": self.qvel} if velocities else {})
        found = {f"qpos/{j.name}": _squeezed(self.qpos[:, j.q]) for j in every}
        if velocities:
            found |= {f"qvel/{j.name}": _squeezed(self.qvel[:, j.v]) for j in every}
        return found

    def controls(self) -> dict[str, Floats]:
        driven = [a for a in actuators(self.model) if a.driven]
        values = self._control[self._held]
        if not all(a.name for a in driven):
            return {"ctrl": values}
        return {f"ctrl/{a.name}": _squeezed(values[:, a.ctrl]) for a in driven}

    def sensors(self) -> dict[str, Floats]:
        """Sensor data belong to the state before a step: the last state has none."""
        model = self.model
        if self._sensors is None or not model.nsensor:
            return {}
        data = _host(self._sensors)[self._world]
        data = np.concatenate([data, np.full((1, data.shape[1]), np.nan)])
        high = np.minimum(self._place.base + 1, len(data) - 1)
        values = linear(data[self._place.base], data[high], self._place.part)
        labels = [model.sensor(i).name for i in range(model.nsensor)]
        if not all(labels):
            return {"sensordata": values}
        adr, dim = model.sensor_adr, model.sensor_dim
        return {
            f"sensor/{name}": _squeezed(values[:, adr[i] : adr[i] + dim[i]])
            for i, name in enumerate(labels)
        }

    def poses(self, bodies: Iterable[str]) -> dict[str, Floats]:
        wanted = list(bodies)
        known = {self.model.body(i).name for i in range(self.model.nbody)}
        for name in wanted:
            if name not in known:
                raise InputError(f"there is no body {name!r} to record; known: {sorted(known)}")
        found = {f"xpos/{n}": np.empty((len(self.time), 3)) for n in wanted}
        found |= {f"xquat/{n}": np.empty((len(self.time), 4)) for n in wanted}
        data = mujoco.MjData(self.model)
        for row in range(len(self.time) if wanted else 0):
            data.qpos[:] = self.qpos[row]
            mujoco.mj_kinematics(self.model, data)
            for name in wanted:
                found[f"xpos/{name}"][row] = data.body(name).xpos
                found[f"xquat/{name}"][row] = data.body(name).xquat
        return found


def _each(
    signals: dict[str, Floats],
    amounts: Amounts,
    what: str,
    change: Callable[[str, Floats, float], Floats],
) -> None:
    """Changes the signals that an amount is given for; the more precise name wins."""
    table = {"qpos": amounts} if isinstance(amounts, (int, float)) else dict(amounts)
    for name in table:
        if not any(name in (signal, names.split(signal)[0]) for signal in signals):
            raise InputError(f"{what} names {name!r}; recorded: {', '.join(sorted(signals))}")
    for name, values in signals.items():
        amount = float(table.get(name, table.get(names.split(name)[0], 0.0)))
        if amount:
            signals[name] = change(name, values, amount)


def _noisy(name: str, values: Floats, std: float, rng: np.random.Generator) -> Floats:
    place = _quaternion(name, values)
    noisy = values + std * rng.standard_normal(values.shape)
    if place is not None:
        turn = quat.exp(std * rng.standard_normal((len(values), 3)))
        noisy[:, place] = quat.multiply(values[:, place], turn)
    return noisy


def _rounded(name: str, values: Floats, step: float) -> Floats:
    rounded = np.round(values / step) * step
    place = _quaternion(name, values)
    if place is not None:
        rounded[:, place] = values[:, place]
    return np.asarray(rounded)


def _quaternion(name: str, values: Floats) -> slice | None:
    """Columns of a named signal that form a quaternion."""
    kind, target = names.split(name)
    if kind not in ("qpos", "xquat") or not target or values.ndim == 1:
        return None
    return {4: slice(0, 4), 7: slice(3, 7)}.get(values.shape[1])


def _squeezed(values: Floats) -> Floats:
    return values[:, 0] if values.shape[1] == 1 else values


def _host(array: Any) -> Floats:
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array, np.float64)
