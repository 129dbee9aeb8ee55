"""What an effect looks like along a measured motion: columns of a linear regression.

An effect offers candidates: a few columns with unknown coefficients, and a rule that turns fitted
coefficients into parameter values. A shape parameter that enters nonlinearly (a time constant, a
frequency) is tried at several values, a candidate for each. Where the effect has a known size at
a given parameter value (a delay, a saturation), its column's coefficient is fixed at one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Literal, Protocol

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Kind = Literal["force", "state", "signal"]


@dataclasses.dataclass(frozen=True, eq=False)
class Column:
    """One regressor.

    Attributes:
      kind: `force`: generalized force [M, nv] at the intervals' ends; `state`: change
        [N, 2 nv] of the state over each interval; `signal`: change [M, 2 nv] of the measured
        positions and velocities at the ends of the intervals.
      values: the regressor for a coefficient of one. M = 2 N: all starts, then all ends.
    """

    kind: Kind
    values: Floats


Values = Mapping[str, float]
Solve = Callable[[Floats], Values | None]


@dataclasses.dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a target as columns.

    Attributes:
      effect, target, options: as in `EffectInstance`.
      columns: regressors, at least one.
      solve: parameter values from the fitted coefficients; None if these are not possible (a
        negative friction).
      fixed: whether the coefficients are ones instead of fitted.
      shape: number of shape parameters that were tried at several values.
    """

    effect: str
    target: str
    columns: tuple[Column, ...]
    solve: Solve
    options: Mapping[str, str] = dataclasses.field(default_factory=dict)
    fixed: bool = False
    shape: int = 0


class MotionRegressors(Protocol):
    """The measured motion, as effects look at it.

    Arrays at the ends of the sampling intervals have M = 2 N rows: all starts, then all ends.
    """

    model: mujoco.MjModel
    time: Floats
    """[M], s."""
    qpos: Floats
    """[M, nq]."""
    qvel: Floats
    """[M, nv]."""
    qacc: Floats
    """[M, nv]."""
    ctrl: Floats
    """[M, nu], of the interval that starts or ends there."""
    actuator_force: Floats
    """[M, nactuator] scalar forces."""
    qfrc_actuator: Floats
    """[M, nv]."""
    qfrc_bias: Floats
    """[M, nv]."""
    qfrc_constraint: Floats
    """[M, nv]: of contacts, limits and dry friction."""
    velocity_noise: Floats
    """[nv] standard deviation of the reference velocities."""
    missing_force: Floats | None
    """[N, nv] generalized force that is missing over each interval, where it is known."""

    def moment(self, actuator: int) -> Floats:
        """[M, nv]: generalized force for a unit actuator force."""
        ...

    def control_gain(self, actuator: int) -> Floats:
        """[M]: derivative of the actuator's force by its control."""
        ...

    def filtered_control(self, control: int, time_constant: float) -> Floats:
        """[M]: the control after a first-order filter."""
        ...

    def delayed_control(self, control: int, delay: float) -> Floats:
        """[M]: the control of some time before."""
        ...

    def body_motion(self, body: int) -> BodyMotion:
        """Velocity, acceleration and Jacobians of a body."""
        ...

    def spectrum_peaks(self, dof: int, against: Literal["time", "position"]) -> Floats:
        """Frequencies (Hz, or periods for each turn) that stand out in the missing force."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class BodyMotion:
    """A body along the motion; world frame.

    Attributes:
      com: [M, 3]. spin: [M, 3] angular velocity. velocity: [M, 3] of the centre of mass.
      rotation: [M, 3, 3] of the body's frame. origin: [M, 3] of its frame.
      jac_com: [M, 3, nv]. jac_origin: [M, 3, nv]. jac_spin: [M, 3, nv].
      acc_origin: [M, 3] acceleration of the frame's origin, gravity subtracted.
      spin_acc: [M, 3] angular acceleration.
    """

    com: Floats
    spin: Floats
    velocity: Floats
    rotation: Floats
    origin: Floats
    jac_com: Floats
    jac_origin: Floats
    jac_spin: Floats
    acc_origin: Floats
    spin_acc: Floats

    def force(self, vector: Floats) -> Floats:
        """Generalized force [M, nv] of a force [M, 3] or [3] at the centre of mass."""
        return np.asarray(
            np.einsum("mij,mi->mj", self.jac_com, np.broadcast_to(vector, self.com.shape))
        )

    def point_inertia(self, position: Floats) -> Floats:
        """Generalized force [M, nv] of the inertia and weight of 1 kg at a point of the body."""
        arm = np.einsum("mij,j->mi", self.rotation, position)
        acceleration = (
            self.acc_origin
            + np.cross(self.spin_acc, arm)
            + np.cross(self.spin, np.cross(self.spin, arm))
        )
        at_point = np.einsum("mij,mi->mj", self.jac_origin, acceleration)
        turning = np.einsum("mij,mi->mj", self.jac_spin, np.cross(arm, acceleration))
        return np.asarray(-(at_point + turning))


def directions(speed: Floats, blur: float) -> Floats:
    """The sign of a velocity, blurred where the velocity is not known better than `blur`."""
    return np.asarray(np.tanh(speed / max(blur, 1e-12)))


def keyed(*names: str) -> Solve:
    """Coefficients as values of these parameters, in order."""
    return lambda c: {name: float(value) for name, value in zip(names, c, strict=True)}


def positive(*names: str) -> Solve:
    """As `keyed`, but only if the first is positive."""
    plain = keyed(*names)
    return lambda c: plain(c) if c[0] > 0 else None
