"""Effects at joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from orbisim.effects.base import (
    LARGE,
    Effect,
    EffectInstance,
    Extent,
    Hook,
    Parameter,
    StepInputs,
    index_of,
    is_scalar_joint,
    joint_unit,
    leverage,
    names_of_kind,
    only_if,
    reach,
    spec_element,
)
from orbisim.effects.screening import (
    Candidate,
    Column,
    Floats,
    MotionRegressors,
    Solve,
    Values,
    directions,
    keyed,
    positive,
)
from orbisim.errors import InputError
from orbisim.scene.hidden import hide_joint

_FALLS = (0.01, 0.6)
"""Where friction may fall from static to Coulomb, in units of the joint's typical velocity: far
below it is Coulomb friction, far above it Coulomb friction with less damping."""


class JointEffect(Effect):
    """An effect at a hinge or a slide."""

    kind = "joint"

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Hinges and slides only."""
        return is_scalar_joint(model, target)

    def candidate(
        self, view: MotionRegressors, target: str, forces: list[Floats], solve: Solve, **more: Any
    ) -> Candidate:
        """Columns of generalized forces [M] at the joint's own degree of freedom."""
        columns = tuple(_at_dof(view, target, force) for force in forces)
        return Candidate(self.name, target, columns, solve, **more)


class CoulombFriction(JointEffect):
    """Dry friction of constant size against the motion: MJCF `frictionloss`, added to."""

    name = "coulomb_friction"
    phrase = "Coulomb friction"
    common = True
    declared_as = "frictionloss"
    family = "friction"
    needs = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit = joint_unit(model, target, "N*m", "N")
        return (Parameter("torque", unit, 0.0, LARGE, 0.1),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        spec_element(spec, "joint", instance.target).frictionloss += instance.values["torque"]

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        return [self.candidate(view, target, [-_sign(view, target)], positive("torque"))]


class ViscousDamping(JointEffect):
    """Damping proportional to velocity: the first coefficient of MJCF `damping`, added to."""

    name = "viscous_damping"
    phrase = "viscous damping"
    common = True
    declared_as = "damping"
    family = "friction"
    needs = (mujoco.mjtDisableBit.mjDSBL_DAMPER,)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit = joint_unit(model, target, "N*m*s/rad", "N*s/m")
        least = -float(model.dof_damping[_dof(model, target)].max())  # no joint drives itself
        limits = (least, LARGE)
        return (Parameter("coefficient", unit, -LARGE, LARGE, 0.1, possible=limits),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        joint = spec_element(spec, "joint", instance.target)
        joint.damping[0] += instance.values["coefficient"]

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        return [self.candidate(view, target, [-_speed(view, target)], keyed("coefficient"))]


class QuadraticDamping(JointEffect):
    """c v |v|: the second coefficient of MJCF `damping`, added to."""

    name = "quadratic_damping"
    rarity = -2.0
    phrase = "quadratic damping"
    family = "friction"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit = joint_unit(model, target, "N*m*s^2/rad^2", "N*s^2/m^2")
        return (Parameter("coefficient", unit, 0.0, LARGE, 0.05),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        joint = spec_element(spec, "joint", instance.target)
        joint.damping[1] += instance.values["coefficient"]

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        v = _speed(view, target)
        return [self.candidate(view, target, [-v * np.abs(v)], positive("coefficient"))]


class JointSpring(JointEffect):
    """A spring about a rest position: MJCF `stiffness` and `springref`."""

    name = "joint_spring"
    rarity = -1.0
    phrase = "a joint spring"
    declared_as = "stiffness"
    needs = (mujoco.mjtDisableBit.mjDSBL_SPRING,)

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        joint = index_of(model, "joint", target)
        return super().possible(model, target) and not model.jnt_stiffness[joint]

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        stiffness = joint_unit(model, target, "N*m/rad", "N/m")
        position = joint_unit(model, target, "rad", "m")
        return (
            Parameter("stiffness", stiffness, -LARGE, LARGE, 1.0, possible=(0.0, LARGE)),
            Parameter("rest_position", position, -100.0, 100.0, 0.1),
        )

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """It pulls back, to where the joint goes: a spring far away is a constant force."""
        found = super().log_prior(model, instance, extent)
        if extent is None:
            return found
        dof = _dof(model, instance.target)
        away = instance.values["rest_position"] - float(extent.middle[dof])
        usual = max(float(extent.travel[dof]), _STILL)
        return found - float(np.log1p((away / usual) ** 2))

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        joint = spec_element(spec, "joint", instance.target)
        joint.stiffness[0] += instance.values["stiffness"]
        joint.springref = _angle(spec, joint, instance.values["rest_position"])

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        q = _position(view, target)

        def solve(c: Floats) -> dict[str, float] | None:
            if c[0] <= 0:
                return None
            return {"stiffness": float(c[0]), "rest_position": float(c[1] / c[0])}

        return [self.candidate(view, target, [-q, np.ones_like(q)], solve)]


class Armature(JointEffect):
    """Inertia reflected from a rotor through the gear: MJCF `armature`, added to."""

    name = "armature"
    phrase = "reflected rotor inertia"
    common = True
    declared_as = "armature"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit = joint_unit(model, target, "kg*m^2", "kg")
        return (Parameter("inertia", unit, 0.0, LARGE, 0.01),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        spec_element(spec, "joint", instance.target).armature += instance.values["inertia"]

    def elsewhere(
        self, model: mujoco.MjModel, instance: EffectInstance, data: mujoco.MjData
    ) -> list[EffectInstance]:
        """Rotors at other joints, and a mass with that inertia at the centre of the body."""
        found = super().elsewhere(model, instance, data)
        joint = index_of(model, "joint", instance.target)
        body = int(model.jnt_bodyid[joint])
        inertia = leverage(model, data, joint, data.xipos[body])
        if inertia > _ON_AXIS * reach(model, names_of_kind(model, "body")[body]) ** 2:
            parts = dict(
                zip(("com_x", "com_y", "com_z"), model.body_ipos[body].tolist(), strict=True)
            )
            values = {"mass": instance.values["inertia"] / inertia, **parts}
            found.append(EffectInstance("payload", names_of_kind(model, "body")[body], values))
        return found

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        acceleration = view.qacc[:, _dof(view.model, target)]
        return [self.candidate(view, target, [-acceleration], positive("inertia"))]


class Cogging(JointEffect):
    """A torque A sin(n q + phase) of the motor's magnets or the gear's teeth.

    A passive DC motor of negligible motor constant carries it (`dcmotor cogging`); it reads no
    control.
    """

    name = "cogging"
    rarity = -2.0
    phrase = "cogging"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit = joint_unit(model, target, "N*m", "N")
        per = joint_unit(model, target, "1/turn", "1/(2*pi*m)")
        return (
            Parameter("amplitude", unit, 0.0, LARGE, 0.1),
            Parameter("periods", per, 0.5, 1000.0, 6.0),
            Parameter("phase", "rad", -10.0, 10.0, 0.0),
        )

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        values = instance.values
        motor = spec.add_actuator(
            name=f"cogging_{instance.target}",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=instance.target,
        )
        motor.set_to_dcmotor(
            motorconst=[1e-9, 1e-9],
            resistance=1.0,
            cogging=[values["amplitude"], values["periods"], values["phase"]],
            ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE),
        )

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """It has come round twice."""
        if extent is None:
            return 0.0
        dof = int(model.jnt_dofadr[index_of(model, "joint", instance.target)])
        return only_if(instance.values["periods"] * float(extent.travel[dof]) >= 4 * np.pi)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        q = _position(view, target)
        return [
            self.candidate(
                view, target, [np.sin(n * q), np.cos(n * q)], _wave("periods", n), shape=1
            )
            for n in view.spectrum_peaks(_dof(view.model, target), "position")
        ]


class HardStop(JointEffect):
    """An undeclared limit: MJCF `range` on the side where the position lies, and `solreflimit`.

    A stop of metal or rubber is stiffer than MuJoCo's limits are by default (time constant 20 ms),
    and throws the joint back, which these do not: how stiff and how damped it is belongs to it. A
    limit declared at the other end becomes as stiff: MJCF has one `solreflimit` for both.
    """

    name = "hard_stop"
    phrase = "an undeclared hard stop"
    stated = True
    needs = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_LIMIT)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit = joint_unit(model, target, "rad", "m")
        time, ratio = _solref(model, target).values()
        return (
            Parameter("position", unit, -100.0, 100.0, 0.5),
            Parameter("side", "1", -1.0, 1.0, 1.0, choice=True),
            Parameter("timeconst", "s", 1e-4, 1.0, time, time, omitted=time),
            Parameter("dampratio", "1", 1e-2, 10.0, ratio, ratio, omitted=ratio),
        )

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        joint = spec_element(spec, "joint", instance.target)
        limit = _angle(spec, joint, instance.values["position"])
        open_end = _angle(spec, joint, 1000.0)
        limited = joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE or (
            joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO and joint.range[0] < joint.range[1]
        )
        low, high = joint.range if limited else (-open_end, open_end)
        upper = instance.values["side"] > 0
        joint.range = [low, min(high, limit)] if upper else [max(low, limit), high]
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        declared = joint.solref_limit if joint.solref_limit[0] > 0 else _SOLREF
        said = (instance.values.get(*pair) for pair in zip(_SOLREF_NAMES, declared, strict=True))
        if "timeconst" in instance.values or "dampratio" in instance.values:
            joint.solref_limit = list(said)

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        return ("position", *_SOLREF_NAMES)

    def encode(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        """Where nothing is said of stiffness and damping, they are the declared limit's."""
        return super().encode(model, target, {**_solref(model, target), **values})

    def complete(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        """No stiffer than the timestep resolves: below two timesteps MuJoCo takes these."""
        return {**values, "timeconst": max(values["timeconst"], 2 * model.opt.timestep)}

    def places(
        self, model: mujoco.MjModel, target: str, courses: Sequence[Floats]
    ) -> list[list[Mapping[str, float]]]:
        """Near both ends of the travel, where an impact is over within a sample or two; as soft as
        limits are declared, and as stiff as steps resolve."""
        travel = float(np.ptp(np.concatenate(courses)))
        found: list[list[Mapping[str, float]]] = []
        for side in (1.0, -1.0):
            ends = _turns([side * q for q in courses], _DEPTHS[1] * travel)
            places = [side * (end - depth * travel) for end in ends for depth in _DEPTHS]
            begins = _solref(model, target), dict(zip(_SOLREF_NAMES, _stiff(model), strict=True))
            found.append(
                [{"position": place, "side": side, **one} for place in places for one in begins]
            )
        return found

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        """A spring and a damper at one end of the travel."""
        q, v = _position(view, target), _speed(view, target)
        found: list[Candidate] = []
        for side in (1.0, -1.0):
            end = float((side * q).max())
            for depth in (0.003, 0.01, 0.03, 0.08, 0.16):
                start = end - depth * float(np.ptp(q))
                beyond = np.clip(side * q - start, 0, None)
                values = {"position": side * start, "side": side}
                values |= _solref(view.model, target)
                forces = [-side * beyond, -np.where(beyond > 0, v, 0.0)]
                found.append(self.candidate(view, target, forces, _if_stiff(values), shape=1))
        return found


_SOLREF_NAMES = ("timeconst", "dampratio")
_SOLREF = (0.02, 1.0)
"""MuJoCo's default of `solreflimit`: time constant, s, and damping ratio."""


def _solref(model: mujoco.MjModel, target: str) -> dict[str, float]:
    """A joint's `solreflimit` as declared; MuJoCo's default where stiffness and damping stand
    instead (negative numbers)."""
    declared = model.jnt_solref[index_of(model, "joint", target)]
    said = declared if declared[0] > 0 else _SOLREF
    return {name: float(value) for name, value in zip(_SOLREF_NAMES, said, strict=True)}


def _stiff(model: mujoco.MjModel) -> tuple[float, float]:
    """`solreflimit` of a stop as stiff as the timestep resolves that throws a joint back at a fifth
    of its speed, as rubber and plastics do: exp(-pi z / sqrt(1 - z^2)) for a damping ratio z."""
    return 2 * float(model.opt.timestep), 0.46


def _turns(every: Sequence[Floats], apart: float) -> list[float]:
    """Where motion ends: its farthest place, and the farthest at which each recording turns back. A
    recording may begin beyond a stop.

    Args:
      every: positions of each recording, growing towards the stop. apart: what is another place.
    """
    found = [max(float(q.max()) for q in every)]
    for q in every:
        inner = q[1:-1][(q[1:-1] >= q[:-2]) & (q[1:-1] >= q[2:])]
        if len(inner):
            found.append(float(inner.max()))
    kept: list[float] = []
    for end in sorted(found, reverse=True):
        if all(abs(end - other) > apart for other in kept):
            kept.append(end)
    return kept[:_ENDS]


_ENDS = 4
"""Each is tried with all depths: the farthest are those where a stop can be."""
_DEPTHS = (0.0, 0.003, 0.01, 0.03, 0.08)
"""How far motion may press into a stop, in units of the travel."""


def _if_stiff(values: dict[str, float]) -> Solve:
    """The values if the stop pushes back."""
    return lambda c: values if c[0] > 0 else None


class Backlash(JointEffect):
    """Play between motor and link: a second joint on the same axis, free within half the width.

    The joint keeps its name, its actuator and its encoder (motor side); the link turns by the
    sum of the two. A small armature on the motor side keeps the equations well posed when the
    joint has none.
    """

    name = "backlash"
    phrase = "backlash"
    structural = True
    stated = True
    needs = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_LIMIT)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("width", joint_unit(model, target, "rad", "m"), 1e-6, 1.0, 0.02),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        joint = spec_element(spec, "joint", instance.target)
        play = _second_joint(spec, joint, f"{instance.target}_backlash")
        half = _angle(spec, joint, instance.values["width"] / 2)
        play.range = [-half, half]
        play.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        play.solref_limit[:] = [2.5 * spec.option.timestep, 1.0]

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        return [{"width": width} for width in (0.005, 0.02, 0.08)]


class JointFlexibility(JointEffect):
    """An elastic transmission: a second joint on the same axis with a spring and a damper.

    The joint keeps its name, its actuator and its encoder (motor side).
    """

    name = "joint_flexibility"
    phrase = "an elastic transmission"
    structural = True
    stated = True
    needs = (mujoco.mjtDisableBit.mjDSBL_SPRING,)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (
            Parameter("stiffness", joint_unit(model, target, "N*m/rad", "N/m"), 1e-3, 1e9, 100.0),
            Parameter("damping", joint_unit(model, target, "N*m*s/rad", "N*s/m"), 0.0, 1e6, 0.1),
        )

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        joint = spec_element(spec, "joint", instance.target)
        bend = _second_joint(spec, joint, f"{instance.target}_flexibility")
        bend.stiffness[0] = instance.values["stiffness"]
        bend.damping[0] = instance.values["damping"]

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        inertia = float(model.dof_M0[_dof(model, target)])
        return [
            {"stiffness": inertia * (2 * np.pi * f) ** 2, "damping": 0.1 * inertia * 2 * np.pi * f}
            for f in (3.0, 8.0, 20.0)
        ]


class StribeckFriction(JointEffect):
    """Friction that falls from a static to the Coulomb level as the joint starts to move.

    Level (Fc + (Fs - Fc) exp(-(v/vs)^2)), set as `frictionloss` at every timestep: the joint
    really sticks.
    """

    name = "stribeck_friction"
    rarity = -2.0
    refines = "coulomb_friction"
    shared = ("coulomb",)
    phrase = "Stribeck friction"
    family = "friction"
    native = False
    needs = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit = joint_unit(model, target, "N*m", "N")
        speed = joint_unit(model, target, "rad/s", "m/s")
        return (
            Parameter("coulomb", unit, 0.0, LARGE, 0.1),
            Parameter("static", unit, 0.0, LARGE, 0.2),
            Parameter("velocity", speed, 1e-4, 100.0, 0.1),
        )

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        """What static friction exceeds the Coulomb level by, instead of the former."""
        return ("coulomb", "excess", "velocity")

    def encode(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        """The excess of static friction; less than the Coulomb level it is not."""
        excess = max(values["static"] - values["coulomb"], 0.0)
        return {"coulomb": values["coulomb"], "excess": excess, "velocity": values["velocity"]}

    def complete(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        """Static friction from its excess."""
        static = max(values["coulomb"], 0.0) + max(values["excess"], 0.0)
        return {"coulomb": values["coulomb"], "static": static, "velocity": values["velocity"]}

    def generalized(
        self, model: mujoco.MjModel, special: EffectInstance, values: Values | None = None
    ) -> list[Values]:
        """Coulomb friction with a little more where the joint hardly moves."""
        if special.effect != CoulombFriction.name or values is None:
            return []
        level = float(special.values["torque"])
        return [{"coulomb": level, "static": _STICKS * level, "velocity": values["velocity"]}]

    def parts(self, instance: EffectInstance) -> list[EffectInstance]:
        """What exceeds the Coulomb level, and that level."""
        level, static = instance.values["coulomb"], instance.values["static"]
        above = instance.replace(coulomb=0.0, static=max(static - level, 0.0))
        own = EffectInstance(CoulombFriction.name, instance.target, {"torque": level})
        return [above, own] if level > 0 else [instance]

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _FrictionLevel(model, instance, _stribeck)

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """It falls at a velocity that the joint has."""
        if extent is None:
            return 0.0
        dof = int(model.jnt_dofadr[index_of(model, "joint", instance.target)])
        low, high = (share * float(extent.speed[dof]) for share in _FALLS)
        return only_if(low <= instance.values["velocity"] <= high)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        speed, sign = _speed(view, target), _sign(view, target)
        typical = float(np.sqrt(np.mean(speed**2))) or 1.0
        found: list[Candidate] = []
        for scale in typical * np.array([0.03, 0.1, 0.2, 0.4, 0.8]):
            bump = sign * np.exp(-((speed / scale) ** 2))
            solve = _stribeck_values(float(scale))
            found.append(self.candidate(view, target, [-sign, -bump], solve, shape=1))
        return found


_STICKS = 1.3
"""Static over Coulomb friction where a search begins."""


class LoadDependentFriction(JointEffect):
    """Friction proportional to the load that the transmission carries.

    The load is the size of the actuators' generalized force at the joint (`load`: actuator), or
    of gravity, Coriolis and constraint forces on it (`load`: external).
    """

    name = "load_dependent_friction"
    rarity = -2.0
    refines = "coulomb_friction"
    phrase = "load-dependent friction"
    family = "friction"
    native = False
    needs = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        half = 0.5  # a transmission that loses more could not be driven backwards
        return (Parameter("coefficient", "1", 0.0, 10.0, 0.1, usual=_LOST, possible=(0.0, half)),)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        load = instance.options.get("load", "actuator")
        if load not in _LOADS:
            raise InputError(f"{self.name}: load is one of {', '.join(_LOADS)}; got {load!r}")
        hook = _FrictionLevel(model, instance, _LOADS[load])
        hook.derived = frozenset(_LOAD_FIELDS[load])
        return hook

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        dof, sign = _dof(view.model, target), _sign(view, target)
        loads = {
            "actuator": view.qfrc_actuator[:, dof],
            "external": (view.qfrc_constraint - view.qfrc_bias)[:, dof],
        }
        return [
            self.candidate(
                view,
                target,
                [-sign * np.abs(load)],
                positive("coefficient"),
                options={"load": name},
            )
            for name, load in loads.items()
            if np.abs(load).max() > 0
        ]


class JointCoupling(JointEffect):
    """Another joint acts on this one: coefficient times the other's actuator torque, position
    or velocity (`by`: torque, position, velocity), added as a generalized force.
    """

    name = "joint_coupling"
    rarity = -3.0
    phrase = "a coupling to another joint"
    native = False

    def targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        found = super().targets(model)
        return found if len(found) > 1 else ()

    def adds_force_with(self, options: Mapping[str, str]) -> bool:
        """By position and velocity; what drives another joint does not follow from the motion."""
        return options.get("by") in ("position", "velocity")

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        force = joint_unit(model, target, "N*m", "N")
        return (Parameter("coefficient", f"{force} per unit", -LARGE, LARGE, 0.1),)

    def units(self, model: mujoco.MjModel, instance: EffectInstance) -> Mapping[str, str]:
        """Of the coefficient: this joint's force by what the other joint has."""
        force = joint_unit(model, instance.target, "N*m", "N")
        other = instance.options["other"]
        torque = joint_unit(model, other, "N*m", "N")
        angle = joint_unit(model, other, "rad", "m")
        by = {
            "torque": {("N*m", "N"): "m", ("N", "N*m"): "1/m"}.get((force, torque), "1"),
            "position": f"{force}/{angle}",
            "velocity": f"{force}*s/{angle}",
        }
        return {"coefficient": by[instance.options.get("by", "torque")]}

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Coupling(model, instance)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        model, found = view.model, []
        for other in self.targets(model):
            if other == target:
                continue
            source = _dof(model, other)
            sources = {
                "torque": view.qfrc_actuator[:, source],
                "position": _position(view, other),
                "velocity": view.qvel[:, source],
            }
            found += [
                self.candidate(
                    view, target, [force], keyed("coefficient"), options={"other": other, "by": by}
                )
                for by, force in sources.items()
                if np.ptp(force) > 0
            ]
        return found


# ---------------------------------------------------------------------------------------------


class _FrictionLevel(Hook):
    """Adds a level that depends on the state to a joint's `frictionloss`."""

    derived = frozenset()

    def __init__(self, model: mujoco.MjModel, instance: EffectInstance, level: Any) -> None:
        super().__init__(instance.values)
        self._dof = int(model.jnt_dofadr[index_of(model, "joint", instance.target)])
        self._base = float(model.dof_frictionloss[self._dof])
        self._level = level

    def fields(self, inputs: StepInputs) -> None:
        levels = inputs.fields["dof_frictionloss"]
        levels[:, self._dof] += self._level(self, inputs, self._dof)


def _stribeck(hook: Hook, inputs: StepInputs, dof: int) -> Any:
    speed = inputs.qvel[:, dof] / hook.value("velocity")
    coulomb, static = hook.value("coulomb"), hook.value("static")
    return coulomb + (static - coulomb) * np.exp(-(speed**2))


def _actuator_load(hook: Hook, inputs: StepInputs, dof: int) -> Any:
    return hook.value("coefficient") * np.abs(inputs.derived["qfrc_actuator"][:, dof])


def _external_load(hook: Hook, inputs: StepInputs, dof: int) -> Any:
    force = inputs.derived["qfrc_constraint"][:, dof] - inputs.derived["qfrc_bias"][:, dof]
    return hook.value("coefficient") * np.abs(force)


_LOADS = {"actuator": _actuator_load, "external": _external_load}
_LOAD_FIELDS = {"actuator": ("qfrc_actuator",), "external": ("qfrc_constraint", "qfrc_bias")}


class _Coupling(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        other = instance.options.get("other", "")
        joint, source = (index_of(model, "joint", name) for name in (instance.target, other))
        self._dof, self._source = int(model.jnt_dofadr[joint]), int(model.jnt_dofadr[source])
        self._address = int(model.jnt_qposadr[source])
        self._by = instance.options.get("by", "torque")
        if self._by not in ("torque", "position", "velocity"):
            raise InputError(
                f"joint_coupling: by is torque, position or velocity; got {self._by!r}"
            )
        if self._by == "torque":
            self.derived = frozenset({"qfrc_actuator"})

    def force(self, inputs: StepInputs) -> None:
        if self._by == "torque":
            source = inputs.derived["qfrc_actuator"][:, self._source]
        elif self._by == "position":
            source = inputs.qpos[:, self._address]
        else:
            source = inputs.qvel[:, self._source]
        inputs.qfrc[:, self._dof] += self.value("coefficient") * source


def _dof(model: mujoco.MjModel, joint: str) -> int:
    return int(model.jnt_dofadr[index_of(model, "joint", joint)])


def _position(view: MotionRegressors, joint: str) -> Floats:
    return np.asarray(
        view.qpos[:, int(view.model.jnt_qposadr[index_of(view.model, "joint", joint)])]
    )


def _speed(view: MotionRegressors, joint: str) -> Floats:
    return np.asarray(view.qvel[:, _dof(view.model, joint)])


def _sign(view: MotionRegressors, joint: str) -> Floats:
    return directions(_speed(view, joint), float(view.velocity_noise[_dof(view.model, joint)]))


def _at_dof(view: MotionRegressors, joint: str, force: Floats) -> Column:
    values = np.zeros((len(force), view.model.nv))
    values[:, _dof(view.model, joint)] = force
    return Column("force", values)


def _wave(shape: str, value: float) -> Solve:
    """Amplitude and phase of c0 sin + c1 cos = A sin(. + phase)."""

    def solve(c: Floats) -> dict[str, float]:
        return {
            "amplitude": float(np.hypot(c[0], c[1])),
            shape: float(value),
            "phase": float(np.arctan2(c[1], c[0])),
        }

    return solve


def _stribeck_values(velocity: float) -> Solve:
    def solve(c: Floats) -> dict[str, float] | None:
        if c[1] <= 0 or c[0] < 0:
            return None
        return {"coulomb": float(c[0]), "static": float(c[0] + c[1]), "velocity": velocity}

    return solve


def _angle(spec: mujoco.MjSpec, joint: Any, value: float) -> float:
    """An angle in the document's unit (a length stays as it is)."""
    hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    return float(np.degrees(value)) if spec.compiler.degree and hinge else value


def _second_joint(spec: mujoco.MjSpec, joint: Any, name: str) -> Any:
    """A further joint on the same axis of the same body; the first becomes the motor's side."""
    body = joint.parent
    if not joint.armature:
        joint.armature = _MOTOR_ARMATURE
    hide_joint(spec, name)
    return body.add_joint(name=name, type=joint.type, axis=list(joint.axis), pos=list(joint.pos))


_MOTOR_ARMATURE = 1e-3
"""kg m^2 (kg) of a motor that is declared without: a degree of freedom needs some inertia."""

_ON_AXIS = 1e-4
"""Square of the distance from an axis, over that of the body's reach, that is none."""
_STILL = 1e-3
"""rad or m: travel of a joint that does not move."""
_LOST = 0.2
"""Share of what a gear carries that it loses: spur gears 0.02 a stage, worms and screws half."""
