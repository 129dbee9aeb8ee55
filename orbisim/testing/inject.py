"""`inject_effect`: recordings of a scene that has effects which its document does not declare."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.effects import EffectInstance, Hook, add_effects, find
from orbisim.effects.measured import distort, longest_delay
from orbisim.errors import DivergedError, InputError
from orbisim.recording import Recording
from orbisim.recording import quaternions as quat
from orbisim.recording.joints import Joint, joints
from orbisim.recording.sensors import sensors as sensors_of
from orbisim.registry import make_backend
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.testing.excitation import Excitation, default_duration, excite

Floats = npt.NDArray[np.float64]
Policy = Callable[[Floats, Floats, Floats], Floats]
"""Controls [E, nu] from the time [E], qpos [E, nq] and qvel [E, nv] of the declared joints."""

VELOCITY_NOISE = 10.0
"""Noise of velocities over noise of positions, 1/s, unless asked for otherwise."""


def inject_effect(
    scene: Scene,
    effects: EffectInstance | Iterable[EffectInstance],
    *,
    controls: npt.ArrayLike | Policy | None = None,
    starts: npt.ArrayLike | None = None,
    duration: float | None = None,
    rate: float = 100.0,
    episodes: int = 4,
    noise: float = 1e-4,
    velocity_noise: float | None = None,
    velocities: bool = True,
    sensors: bool = False,
    sensor_noise: float = 0.0,
    seed: int = 0,
    hooks: Callable[[mujoco.MjModel], Sequence[Hook]] | None = None,
) -> list[Recording]:
    """Recordings as a rig would give them whose reality has effects that the scene lacks.

    The scene with the effects is simulated by C MuJoCo. Recorded are the joints and controls that
    the scene declares, never states that the effects add; a joint with play or elasticity keeps its
    encoder on the motor's side. Before an episode begins its first control has been held: lags and
    delays start from it, and elastic joints start at rest under gravity.

    Args:
      scene: as declared.
      effects: one or several; none for a scene that is right.
      controls: [T, nu] or [episodes, T, nu], one row for each sampling interval; or a controller,
        called at every sample; by default `orbisim.testing.excitation` chooses.
      starts: [nq + nv] or [episodes, nq + nv], positions and velocities of the declared joints; by
        default chosen too.
      duration: of an episode, s; by default 8, for thrown bodies 1.5.
      rate: samples per second; the interval must be a whole number of the scene's timesteps.
      episodes: number of recordings.
      noise: standard deviation of white noise, rad or m; rotations turn by it about each axis.
      velocity_noise: the same of velocities, rad/s or m/s; ten times `noise` per second if None.
      velocities: whether velocities are recorded.
      sensors: whether the scene's named sensors are recorded.
      sensor_noise: standard deviation of white noise on their readings, in the unit of each.
      seed: of the excitation and the noise.
      hooks: effects that no catalogue knows: makes hooks for the simulated model.

    Raises:
      UnknownNameError: there is no such effect or target.
      InputError: a value, shape or rate does not fit.
      DivergedError: the simulation became non-finite; the error names the episodes and effects.
    """
    wanted = [effects] if isinstance(effects, EffectInstance) else list(effects)
    for one in wanted:
        find(one.effect).check(scene.model, one)
    nstep = _steps_per_sample(scene, rate)
    if duration is None:
        duration = default_duration(scene)
    extra = int(np.ceil(longest_delay(wanted) * rate))
    planned = _excitation(scene, controls, starts, duration + extra / rate, rate, episodes, seed)
    simulated = [one for one in wanted if not find(one.effect).measurement]
    try:
        true = add_effects(scene, simulated)
        stride = 1 if extra or sensors else nstep
        run = _simulate(scene, true, planned, (nstep, stride), hooks, sensors)
    except DivergedError as error:
        names = ", ".join(map(str, wanted)) or "no effect"
        raise DivergedError(f"injecting {names}: {error}", error.worlds) from None
    level = VELOCITY_NOISE * noise if velocity_noise is None else velocity_noise
    found = []
    for e in range(len(planned.qpos)):
        clean = _recording(scene, run, e, velocities=True)
        measured = _measured(clean, wanted, scene, nstep)
        measured = measured if velocities else measured.select(lambda n: not n.startswith("qvel"))
        rng = np.random.default_rng([seed, e, 1])
        levels = {"qpos": noise, "qvel": level, "sensor": sensor_noise}
        found.append(add_noise(measured, levels, scene, rng))
    return found


# -- excitation ------------------------------------------------------------------------------------


def _steps_per_sample(scene: Scene, rate: float) -> int:
    timestep = float(scene.model.opt.timestep)
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"the rate must be positive; got {rate}")
    steps = 1.0 / (rate * timestep)
    nstep = round(steps)
    if nstep < 1 or abs(steps - nstep) > 1e-6 * steps:
        near = 1.0 / (max(1, nstep) * timestep)
        raise InputError(
            f"{rate:g} samples per second are no whole number of timesteps of {timestep:g} s; "
            f"{near:g} would be"
        )
    return nstep


def _excitation(
    scene: Scene,
    controls: npt.ArrayLike | Policy | None,
    starts: npt.ArrayLike | None,
    duration: float,
    rate: float,
    episodes: int,
    seed: int,
) -> Excitation:
    planned = excite(scene, duration=duration, rate=rate, episodes=episodes, seed=seed)
    if starts is not None:
        planned = _started(scene, planned, np.asarray(starts, np.float64), episodes)
    if controls is None:
        return planned
    if callable(controls):
        ticks = np.arange(planned.reference.shape[1]) / rate
        reference = np.tile(ticks[None, :, None], (episodes, 1, 1))
        policy = controls
        return dataclasses.replace(
            planned, reference=reference, feedback=lambda t, q, v: policy(t[:, 0], q, v)
        )
    given = np.asarray(controls, np.float64)
    if given.ndim == 2:
        given = np.repeat(given[None], episodes, axis=0)
    if given.ndim != 3 or given.shape[0] != episodes or given.shape[2] != scene.model.nu:
        raise InputError(
            f"controls have shape {np.shape(controls)}; needed: (T, {scene.model.nu}) or "
            f"({episodes}, T, {scene.model.nu})"
        )
    return dataclasses.replace(planned, reference=given, feedback=None)


def _started(scene: Scene, planned: Excitation, starts: Floats, episodes: int) -> Excitation:
    nq, nv = scene.model.nq, scene.model.nv
    if starts.shape not in ((nq + nv,), (episodes, nq + nv)):
        raise InputError(
            f"starts have shape {starts.shape}; needed: ({nq + nv},) or ({episodes}, {nq + nv})"
        )
    rows = np.broadcast_to(starts, (episodes, nq + nv))
    return dataclasses.replace(planned, qpos=rows[:, :nq].copy(), qvel=rows[:, nq:].copy())


# -- simulation ------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Run:
    """Declared part of E runs: time [N], qpos [E, N, nq], qvel [E, N, nv], ctrl [E, N, nu], and
    sensordata [E, N, nsensordata] if asked for."""

    time: Floats
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    sensordata: Floats | None = None


def _simulate(
    scene: Scene,
    true: Scene,
    planned: Excitation,
    steps: tuple[int, int],
    hooks: Callable[[mujoco.MjModel], Sequence[Hook]] | None,
    sensors: bool = False,
) -> _Run:
    """Runs the true scene; `steps`: timesteps of a control, and between recorded states (one if
    there are sensors, whose readings of a state come with the step after it)."""
    nstep, stride = steps
    count, worlds = planned.reference.shape[1], len(planned.qpos)
    engine = make_backend("mujoco", true, nworld=worlds, hooks=hooks)
    engine.report = frozenset({"sensordata"} if sensors else ())
    layout = _Layout(scene.model, true.model)
    limits = _limits(scene.model)
    ctrl = np.clip(planned.control(0, planned.qpos, planned.qvel), *limits)
    state = _initial(engine, layout, planned, ctrl)
    qpos, qvel, held = [planned.qpos], [planned.qvel], []
    read: list[Floats] = []
    for k in range(count):
        ctrl = np.clip(planned.control(k, qpos[-1], qvel[-1]), *limits)
        same = ctrl[:, None].repeat(nstep // stride, axis=1)
        part = engine.rollout(state, same, nstep=stride, sensors=sensors, raise_on_divergence=True)
        state = part.final
        read += [] if part.sensordata is None else list(np.moveaxis(part.sensordata, 1, 0))
        for i in range(nstep // stride):
            qpos.append(part.qpos[:, i][:, layout.q])
            qvel.append(part.qvel[:, i][:, layout.v])
            held.append(ctrl)
    held.append(ctrl)
    if read:
        last = engine.rollout(state, ctrl[:, None], sensors=True).sensordata
        read.append(np.asarray(last)[:, 0])
    seen = np.stack(read, 1) if read else None
    time = np.asarray(np.arange(len(held)) * stride * scene.model.opt.timestep, np.float64)
    return _Run(time, np.stack(qpos, 1), np.stack(qvel, 1), np.stack(held, 1), seen)


def _limits(model: mujoco.MjModel) -> tuple[Floats, Floats]:
    """What a rig's software sends at most: the declared control ranges."""
    limited = np.asarray(model.actuator_ctrllimited[: model.nu], bool)
    low = np.where(limited, model.actuator_ctrlrange[: model.nu, 0], -np.inf)
    high = np.where(limited, model.actuator_ctrlrange[: model.nu, 1], np.inf)
    return low, high


class _Layout:
    """Where the declared coordinates stand in the simulated scene.

    Attributes:
      q: [nq], v: [nv] addresses. hidden: joints that only the simulated scene has.
    """

    def __init__(self, declared: mujoco.MjModel, true: mujoco.MjModel) -> None:
        known = {joint.label: joint for joint in joints(declared)}
        self.q, self.v = np.zeros(declared.nq, int), np.zeros(declared.nv, int)
        self.hidden: list[Joint] = []
        for joint in joints(true):
            own = known.get(joint.label)
            if own is None:
                self.hidden.append(joint)
            else:
                self.q[own.q] = np.arange(joint.q.start, joint.q.stop)
                self.v[own.v] = np.arange(joint.v.start, joint.v.stop)


def _initial(engine: Backend, layout: _Layout, planned: Excitation, ctrl: Floats) -> State:
    """The state at the start: as planned, and hidden states as after a long rest."""
    state, model = engine.reset(len(planned.qpos)), engine.model
    qpos, qvel = np.array(state.qpos), np.array(state.qvel)
    qpos[:, layout.q], qvel[:, layout.v] = planned.qpos, planned.qvel
    act, memory = np.array(state.act), dict(state.memory)
    for a in range(model.nactuator):
        if model.actuator_actadr[a] >= 0 and model.actuator_dyntype[a] in _FILTERS:
            act[:, int(model.actuator_actadr[a])] = ctrl[:, int(model.actuator_ctrladr[a])]
    data = mujoco.MjData(model)
    for world in range(len(qpos)):
        _settle(model, data, qpos[world], layout.hidden)
        if model.nhistory:
            memory["history"][world] = _buffers(model, data, ctrl[world])
    return state.replace(qpos=qpos, qvel=qvel, act=act, memory=memory)


_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))


def _buffers(model: mujoco.MjModel, data: mujoco.MjData, ctrl: Floats) -> Floats:
    """Delay buffers when the controls have been held for long."""
    for a in np.flatnonzero(model.actuator_historyadr >= 0):
        count = int(model.actuator_history[a, 0])
        times = -float(model.opt.timestep) * np.arange(count, 0, -1)
        values = np.full(count, ctrl[int(model.actuator_ctrladr[a])])
        mujoco.mj_initCtrlHistory(model, data, int(a), times, values)
    return np.array(data.history)


def _settle(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: Floats, hidden: Iterable[Joint]
) -> None:
    """Puts hidden joints where gravity holds them: springs bent, play at one of its ends."""
    chosen = list(hidden)
    for _ in range(20 if chosen else 0):
        data.qpos[:], data.qvel[:] = qpos, 0.0
        mujoco.mj_forward(model, data)
        for joint in chosen:
            load = -float(data.qfrc_bias[joint.v.start])
            stiffness = float(np.ravel(model.jnt_stiffness[joint.id])[0])
            if stiffness:
                qpos[joint.q.start] = load / stiffness
            elif model.jnt_limited[joint.id]:
                qpos[joint.q.start] = model.jnt_range[joint.id][int(load > 0)]


# -- recording -------------------------------------------------------------------------------------


def _recording(scene: Scene, run: _Run, episode: int, velocities: bool) -> Recording:
    model, signals = scene.model, {}
    every = joints(model)
    blocks = {"qpos": run.qpos[episode]} | ({"qvel": run.qvel[episode]} if velocities else {})
    for kind, values in blocks.items():
        if not all(joint.name for joint in every):
            signals[kind] = values
            continue
        for joint in every:
            signals[f"{kind}/{joint.name}"] = values[:, joint.q if kind == "qpos" else joint.v]
    names = [model.actuator(a).name for a in range(model.nactuator) if model.actuator_ctrlnum[a]]
    ctrl = run.ctrl[episode]
    if model.nu and all(names) and len(names) == model.nu:
        signals |= {f"ctrl/{name}": ctrl[:, u] for u, name in enumerate(names)}
    elif model.nu:
        signals["ctrl"] = ctrl
    if run.sensordata is not None:
        readings = run.sensordata[episode]
        named = [one for one in sensors_of(model) if one.name]
        signals |= {f"sensor/{one.name}": readings[:, one.place] for one in named}
    return Recording(run.time, signals, source=f"{scene.name}-{episode}")


def _measured(
    clean: Recording, effects: Sequence[EffectInstance], scene: Scene, nstep: int
) -> Recording:
    """What sensors make of the motion at every timestep, sampled where controls change."""
    clocks = [one for one in effects if one.effect == "clock_skew"]
    seen = distort(clean, [one for one in effects if one not in clocks], scene)
    steps = np.round(seen.time / float(scene.model.opt.timestep)).astype(np.int64)
    return distort(seen.rows(np.flatnonzero(steps % nstep == 0)), clocks, scene)


def add_noise(
    recording: Recording,
    std: dict[str, float],
    scene: Scene,
    rng: np.random.Generator,
) -> Recording:
    """White Gaussian noise on joint signals and sensors.

    Args:
      recording: without noise.
      std: standard deviation by kind of signal (`qpos`, `qvel`); rotations in `qpos` are turned by
        a random vector with this standard deviation about each axis.
      scene: whose joints are recorded.
      rng: source of the noise.
    """
    signals = dict(recording.signals)
    rotations = _rotations(scene)
    for name in sorted(signals):
        amount = std.get(name.partition("/")[0], 0.0)
        if not amount:
            continue
        values = np.array(signals[name])
        noisy = values + amount * rng.standard_normal(values.shape)
        for place in rotations.get(name, []):
            turn = quat.exp(amount * rng.standard_normal((len(values), 3)))
            noisy[:, place] = quat.multiply(values[:, place], turn)
        signals[name] = noisy
    return recording.replace(signals=signals)


def _rotations(scene: Scene) -> dict[str, list[slice]]:
    """Columns of quaternions by name of the signal."""
    found: dict[str, list[slice]] = {"qpos": []}
    for joint in joints(scene.model):
        if joint.quat is not None:
            found["qpos"].append(joint.quat)
            start = joint.quat.start - joint.q.start
            found[f"qpos/{joint.name}"] = [slice(start, start + 4)]
    return found
