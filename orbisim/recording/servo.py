"""The controls that position servos must have had, from a motion alone."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_smoothing_spline

from orbisim.recording.actuators import Actuator, actuators
from orbisim.recording.recording import Recording

Floats = npt.NDArray[np.float64]

_FEWEST = 6
"""Samples that a smoothing spline needs at least."""
_BENDING = -12.0, 6.0
"""Powers of ten between which a spline's penalty on bending is looked for, s^3."""
_RESTS = 1e-9
"""A joint that moves by less, rad or m, stands still."""


def with_controls(recording: Recording, model: mujoco.MjModel) -> Recording:
    """The recording with the controls of its servos, which were not recorded.

    A servo's force is `gain ctrl + bias`, affine in length and velocity (MuJoCo's `position` and
    `velocity` actuators); the force that the motion needs comes from inverse dynamics along the
    smoothed motion, without contacts: a servo that is stiff enough to follow its command moves by
    little under them. Each control is that of the middle of the interval for which it is held. How
    smooth the motion is the samples say (generalised cross-validation), and the noise that the
    recording states in `metadata["noise"]`, if it is more: errors that are alike from sample to
    sample look like motion, which a servo's control would have to follow.

    Args:
      recording: with positions `qpos/<joint>` of all joints that have one coordinate.
      model: of the scene.

    Returns:
      The same recording if no servo's control is missing, or joints are. A note says what was
      inferred, and which actuators are no servos and stay unknown.
    """
    scalar = [
        j
        for j in range(model.njnt)
        if int(model.jnt_type[j]) in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
    ]
    joints = {j: f"qpos/{model.joint(j).name}" for j in scalar}
    missing = [
        a for a in actuators(model) if a.driven and f"ctrl/{a.name}" not in recording.signals
    ]
    servos = [a for a in missing if _is_servo(model, a)]
    there = all(name in recording.signals for name in joints.values())
    if not servos or not there or "ctrl" in recording.signals or len(recording) < _FEWEST:
        return recording
    motion = {j: np.asarray(recording.signals[name]) for j, name in joints.items()}
    if any(np.isfinite(values).sum() < _FEWEST for values in motion.values()):
        return recording
    stated = recording.metadata.get("noise")
    known = stated if isinstance(stated, Mapping) else {}
    noise = {j: _number(known.get(name)) for j, name in joints.items()}
    found = _controls(model, np.asarray(recording.time), motion, noise, servos)
    notes = [f"controls of {', '.join(a.name for a in servos)} follow from the motion"]
    others = [a.name for a in missing if a not in servos]
    if others:
        notes.append(f"controls of {', '.join(others)} are unknown: they are no servos")
    signals = {f"ctrl/{a.name}": found[:, i] for i, a in enumerate(servos)}
    return recording.replace(
        signals={**recording.signals, **signals}, notes=(*recording.notes, *notes)
    )


def _is_servo(model: mujoco.MjModel, actuator: Actuator) -> bool:
    """Whether its force is affine in one control, length and velocity, without a state."""
    number = actuator.id
    return bool(
        actuator.ctrl.stop - actuator.ctrl.start == 1
        and int(model.actuator_dyntype[number]) == mujoco.mjtDyn.mjDYN_NONE
        and int(model.actuator_gaintype[number]) == mujoco.mjtGain.mjGAIN_FIXED
        and int(model.actuator_biastype[number]) == mujoco.mjtBias.mjBIAS_AFFINE
        and model.actuator_gainprm[number, 0] != 0.0
        and np.any(model.actuator_biasprm[number, 1:3])
    )


def _controls(
    model: mujoco.MjModel,
    time: Floats,
    joints: Mapping[int, Floats],
    noise: Mapping[int, float],
    servos: Sequence[Actuator],
) -> Floats:
    """[T, servos]: held from each sample to the next."""
    free = copy.copy(model)
    free.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(free)
    middle = np.append(0.5 * (time[1:] + time[:-1]), time[-1])
    scalar = list(joints)
    columns, dofs = model.jnt_qposadr[scalar], model.jnt_dofadr[scalar]
    motion = np.stack([_smoothed(time, joints[j], middle, noise[j]) for j in scalar], axis=-1)
    numbers = [servo.id for servo in servos]
    moment = np.zeros((model.nu, model.nv))
    found = np.zeros((len(time), len(servos)))
    for t in range(len(time)):
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0.0, 0.0
        data.qpos[columns], data.qvel[dofs], data.qacc[dofs] = motion[:, t]
        mujoco.mj_inverse(free, data)
        mujoco.mj_fwdActuation(free, data)
        mujoco.mju_sparse2dense(
            moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        rows = moment[numbers]
        force = np.linalg.lstsq(rows[:, dofs].T, data.qfrc_inverse[dofs], rcond=None)[0]
        for i, number in enumerate(numbers):
            found[t, i] = _control(free, data, number, float(force[i]))
    return found


def _control(model: mujoco.MjModel, data: mujoco.MjData, number: int, force: float) -> float:
    """The control at which an actuator has this force."""
    if model.actuator_forcelimited[number]:
        force = float(np.clip(force, *model.actuator_forcerange[number]))
    constant, stiffness, damping = model.actuator_biasprm[number, :3]
    bias = constant + stiffness * data.actuator_length[number]
    bias += damping * data.actuator_velocity[number]
    value = (force - bias) / model.actuator_gainprm[number, 0]
    address = int(model.actuator_ctrladr[number])
    if model.actuator_ctrllimited[address]:
        value = np.clip(value, *model.actuator_ctrlrange[address])
    return float(value)


def _number(stated: object) -> float:
    """A stated standard deviation; 0 if there is none."""
    known = isinstance(stated, (int, float)) and np.isfinite(stated)
    return float(stated) if known else 0.0  # type: ignore[arg-type]


def _smoothed(time: Floats, values: Floats, at: Floats, noise: float) -> Floats:
    """[3, T]: position, velocity and acceleration at times.

    The spline that generalised cross-validation finds, or the smoothest one that is off from the
    samples by the stated noise (Reinsch, Numerische Mathematik 10, 1967), if that is smoother.
    """
    good = np.isfinite(values)
    if np.ptp(values[good]) < _RESTS:
        return np.stack([np.full(len(at), values[good][0]), np.zeros(len(at)), np.zeros(len(at))])
    when, samples = time[good], values[good]

    def off(spline: BSpline) -> float:
        return float(np.sqrt(np.mean((spline(when) - samples) ** 2)))

    spline = make_smoothing_spline(when, samples)
    if off(spline) < noise:
        low, high = _BENDING
        while high - low > 0.1:
            middle = 0.5 * (low + high)
            smoother = make_smoothing_spline(when, samples, lam=10.0**middle)
            low, high = (middle, high) if off(smoother) < noise else (low, middle)
        spline = make_smoothing_spline(when, samples, lam=10.0**low)
    return np.stack([spline(at), spline.derivative(1)(at), spline.derivative(2)(at)])
