"""The peer: mujoco.sysid with four parameters a joint, as its users set it up.

Armature, friction loss, damping and stiffness of every hinge and slide are fitted to windows of the
recordings, starting from the declared values with bounds up to a multiple of what the joint's
inertia and torques suggest. Free joints have no such parameters: those scenes stay as declared.
A fit whose time is over ends with the best values so far.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco import sysid
from mujoco.sysid._src import optimize, parameter, residual, timeseries, trajectory

from orbisim import Recording, Scene, load_scene, replay
from orbisim.recording import bind
from orbisim.recording.bound import Bound
from orbisim.recording.initial import starts
from orbisim.recording.joints import joints
from orbisim.recording.windows import cut
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]

WINDOW = 0.5
KINDS = ("armature", "frictionloss", "damping", "stiffness")

__all__ = ["fit", "fitted_scene", "sysid"]


class _Ended(Exception):
    """The fit is over before its end, with the reason."""


def fit(
    scene: Path,
    recordings: Sequence[Path],
    held_out: Sequence[Path],
    seconds: float,
    declared_start: bool = False,
) -> dict[str, Any]:
    """Fits for at most so many seconds, and scores the fitted scene on held-out recordings: free
    runs over the windows that the diagnosis is scored on.

    Args:
      declared_start: whether it begins at the declared values; else where these are small at 5 % of
        the largest, as a fit that begins at a bound may stall there.
    """
    declared = load_scene(scene, trusted=True)
    seen = [Recording.load(path) for path in recordings]
    held = [Recording.load(path) for path in held_out]
    before = replay(declared, held, window=WINDOW).rms
    fitted, values, verdict = fitted_scene(declared, seen, seconds, declared_start)
    after = replay(fitted, held, window=WINDOW).rms
    return {
        "verdict": verdict,
        "values": values,
        "error": {"held_out": {"before": before, "after": after}, "window_s": WINDOW},
    }


def fitted_scene(
    declared: Scene, recordings: Sequence[Recording], seconds: float, declared_start: bool
) -> tuple[Scene, dict[str, float], str]:
    """The scene with fitted numbers, these by name, and how the fit ended."""
    started = time.perf_counter()
    parameters = _parameters(declared, declared_start)
    if not parameters.size:
        return declared, {}, "nothing to fit"
    sequences = _sequences(declared, recordings)
    found, verdict = _optimum(parameters, sequences, started + seconds)
    spec, values = declared.spec, {}
    for one in found.values():
        one.apply_modifier(spec)
        values[one.name] = float(np.ravel(one.value)[0])
    return Scene.from_spec(spec, source=declared.source), values, verdict


def _optimum(
    parameters: parameter.ParameterDict, sequences: trajectory.ModelSequences, until: float
) -> tuple[parameter.ParameterDict, str]:
    """The fitted parameters, and `fitted`; or the best ones, and `stopped` when time is up or
    `diverged` where a simulation did: MuJoCo then begins anew, and sysid refuses its times."""
    best: list[Floats] = []
    try:
        found, _ = optimize.optimize(
            parameters,
            _until(residual.build_residual_fn(models_sequences=[sequences], n_threads=1), until),
            optimizer="mujoco",
            verbose=False,
            max_iters=30,
            iter_callback=lambda trace: best.append(np.ravel(trace[-1].candidate)),
        )
    except _Ended as ended:
        found = parameters.copy()
        if best:
            found.update_from_vector(best[-1])
        return found, str(ended)
    return found, "fitted"


def _until(function: Callable[..., Any], until: float) -> Callable[..., Any]:
    def timed(*args: Any, **kwargs: Any) -> Any:
        if time.perf_counter() > until:
            raise _Ended("stopped")
        try:
            return function(*args, **kwargs)
        except ValueError as error:
            if "strictly increasing" not in str(error):
                raise
            raise _Ended("diverged") from error

    return timed


def _parameters(scene: Scene, declared_start: bool = False) -> parameter.ParameterDict:
    model, found = scene.model, parameter.ParameterDict()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for joint in joints(model):
        if not joint.scalar:
            continue
        dof = joint.v.start
        inertia = float(model.dof_M0[dof])
        declared = {
            "armature": float(model.dof_armature[dof]),
            "frictionloss": float(model.dof_frictionloss[dof]),
            "damping": float(np.ravel(model.dof_damping[dof])[0]),
            "stiffness": float(np.ravel(model.jnt_stiffness[joint.id])[0]),
        }
        for kind in KINDS:
            most = _TYPICAL[kind] * inertia + 3 * declared[kind]
            start = declared[kind] if declared_start else max(declared[kind], 0.05 * most)
            found.add(
                parameter.Parameter(
                    f"{joint.label}_{kind}", start, 0.0, most, modifier=_setter(joint.label, kind)
                )
            )
    return found


_TYPICAL = {"armature": 1.0, "frictionloss": 10.0, "damping": 10.0, "stiffness": 50.0}
"""Upper bounds for a joint of unit inertia: SI, per kg m^2."""


def _setter(joint: str, kind: str) -> Any:
    def modify(spec: mujoco.MjSpec, one: parameter.Parameter) -> None:
        value = float(np.ravel(one.value)[0])
        if kind in ("damping", "stiffness"):
            getattr(spec.joint(joint), kind)[0] = value
        else:
            setattr(spec.joint(joint), kind, value)

    return modify


def _sequences(scene: Scene, recordings: Sequence[Recording]) -> trajectory.ModelSequences:
    runs = [bind(recording, scene) for recording in recordings]
    spec, pulled = _with_motors(scene, runs)
    model = spec.compile()
    step = float(model.opt.timestep)
    names: list[str] = []
    states: list[Floats] = []
    controls: list[Any] = []
    measured: list[Any] = []
    q_map, v_map, _, c_map = timeseries.TimeSeries.compute_all_state_mappings(model)
    for number, bound in enumerate(runs):
        begin = starts(bound, "recorded")
        commands = np.hstack([bound.ctrl, np.nan_to_num(bound.torque[:, pulled])])
        for window in cut(bound.time, WINDOW, begin.usable):
            rows = slice(window.start, window.stop)
            time = bound.time[rows] - bound.time[window.start]
            ticks = np.arange(round(time[-1] / step) + 1) * step
            held = Held(time, commands[rows]).at(ticks + 1e-9)
            first = window.start
            state = trajectory.create_initial_state(model, begin.qpos[first], begin.qvel[first])
            data, mapping = _measured(bound, rows, q_map, v_map, model.nq)
            names.append(f"{number}-{first}")
            states.append(state)
            controls.append(timeseries.TimeSeries(ticks, held, c_map))
            measured.append(timeseries.TimeSeries(time, data, mapping))
    return trajectory.ModelSequences(
        scene.name, spec, names, states, controls, measured, allow_missing_sensors=True
    )


def _with_motors(scene: Scene, runs: Sequence[Bound]) -> tuple[mujoco.MjSpec, list[int]]:
    """The scene with a motor at each joint whose recorded force drives it, which is how such a
    force is given to sysid; and the degrees of freedom that these motors drive."""
    spec, pulled = scene.spec, []
    for joint in joints(scene.model):
        dof = joint.v.start
        if joint.scalar and all(bool(bound.applied[dof]) for bound in runs):
            motor = spec.add_actuator(name=f"force of {joint.label}", target=joint.label)
            motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
            pulled.append(dof)
    return spec, pulled


def _measured(
    bound: Any, rows: slice, q_map: Any, v_map: Any, nq: int
) -> tuple[Floats, dict[str, Any]]:
    """Positions, and velocities where they are recorded, with their places in the columns."""
    columns: list[Floats] = []
    mapping: dict[str, Any] = {}
    position = 0
    for table, values, offset in ((q_map, bound.qpos, 0), (v_map, bound.qvel, nq)):
        for name, (kind, where) in table.items():
            block = values[rows][:, where - offset]
            if not np.isfinite(block).all():
                continue
            mapping[name] = (kind, np.arange(position, position + block.shape[1]))
            columns.append(block)
            position += block.shape[1]
    return np.concatenate(columns, axis=1), mapping
