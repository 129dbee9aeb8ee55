"""What an effect is: a physical phenomenon that a scene may lack, at a target, with parameters.

An effect is written natively into MJCF where MuJoCo can express it. Where it cannot, it travels in
`<custom><text name="orbisim:effects">` as JSON, and the classical backends apply it through a
`Hook` at every timestep. Effects of the measurement (a biased sensor, a fast clock) act on
recordings instead.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Literal

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.flags import impossible
from orbisim.effects.screening import Candidate, MotionRegressors
from orbisim.errors import InputError, UnknownNameError
from orbisim.scene.descriptor import name_of

Floats = npt.NDArray[np.float64]
Values = Mapping[str, float]
AXES = ("x", "y", "z")
"""Components of a vector, as parameters and options name them."""

LARGE = 1e6
"""Bound, in SI units, of what has no bound by nature: far beyond any machine, and still a number
with which the engine's step stays finite."""

TargetKind = Literal["joint", "actuator", "body", "geom", "sensor", "world", "recording"]


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
      name: as it appears in reports.
      unit: SI.
      low, high: bounds of what is physically meaningful.
      scale: a typical size, where a search starts.
      neutral: the value at which nothing changes, where all others have theirs.
      usual: by how much machines that have the effect are off: scale of a Cauchy prior about
        `neutral` (half of them are less off, and ten times that is rare, not impossible). 0 where
        nothing is stated: then the prior is worth one datum, wherever that puts it.
      possible: beyond these no machine is: where a fit ends. A value that ends there, or at a
        bound, is none unless it is neutral: what would have to be larger than it can be stands for
        something else.
      choice: whether it is one of its bounds (the side of a stop), which no fit changes.
      omitted: what it is where nothing is said of it; none if it has to be said.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    neutral: float = 0.0
    usual: float = 0.0
    possible: tuple[float, float] = (-np.inf, np.inf)
    choice: bool = False
    omitted: float | None = None

    def tail(self, value: float) -> float:
        """Logarithm of the prior density at a value over that at its peak."""
        low, high = max(self.low, self.possible[0]), min(self.high, self.possible[1])
        if not low < value < high and value != self.neutral and not self.choice:
            return -np.inf
        return -float(np.log1p(((value - self.neutral) / self.usual) ** 2)) if self.usual else 0.0

    def check(self, effect: str, target: str, value: float) -> float:
        """The value as a float.

        Raises:
          InputError: it is not finite or out of bounds.
        """
        number = float(value)
        if not (np.isfinite(number) and self.low <= number <= self.high):
            raise InputError(
                f"{effect} at {target!r}: {self.name} is {value}; it must be within "
                f"{self.low:g} to {self.high:g} {self.unit}"
            )
        return number


@dataclasses.dataclass(frozen=True)
class EffectInstance:
    """An effect at a target with values, as carried by a scene or named by a diagnosis.

    Attributes:
      effect: name in the catalogue.
      target: name of the joint, actuator, body, geom or sensor; "world" or "recording" for those.
      values: a number for each parameter that cannot be omitted, at least.
      options: choices that are not numbers (the other joint of a coupling, say).
    """

    effect: str
    target: str
    values: Mapping[str, float]
    options: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """As it stands in the MJCF."""
        return {
            "effect": self.effect,
            "target": self.target,
            "parameters": {name: float(value) for name, value in self.values.items()},
            **({"options": dict(self.options)} if self.options else {}),
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> EffectInstance:
        """Reads what `to_json` wrote.

        Raises:
          InputError: a key is missing or a parameter is not a number.
        """
        try:
            values = {str(k): float(v) for k, v in data["parameters"].items()}
            options = {str(k): str(v) for k, v in data.get("options", {}).items()}
            return EffectInstance(str(data["effect"]), str(data["target"]), values, options)
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            raise InputError(f"not an effect: {data!r} ({error!r})") from None

    def replace(self, **values: float) -> EffectInstance:
        """The same effect with other values."""
        return dataclasses.replace(self, values={**self.values, **values})

    def __str__(self) -> str:
        numbers = ", ".join(f"{name}={value:.4g}" for name, value in self.values.items())
        return f"{self.effect}({self.target}: {numbers})"


@dataclasses.dataclass(frozen=True, eq=False)
class Extent:
    """How far recordings go.

    Attributes:
      duration: of the longest one, s. travel: [nv] of each degree of freedom. speed: [nv] its
        velocity, root mean square. middle: [nv] of its travel.
    """

    duration: float
    travel: Floats
    speed: Floats
    middle: Floats


class Effect(abc.ABC):
    """One entry of the catalogue.

    Attributes:
      name: as in contracts and reports.
      kind: what it acts on.
      phrase: the noun phrase of a verdict ("Coulomb friction").
      native: whether MuJoCo expresses it; then `edit` writes it, otherwise `hook` applies it.
      measurement: whether it acts on recordings instead of the simulation.
      structural: whether `edit` changes the model's sizes (adds joints or actuator states).
      stated: whether a regression along the motion says nothing of it, so that it is tried at
        stated values (`places`).
      unranked: whether a regression finds it but says little of what it explains, so that a search
        fits it whatever its rank.
      declared_as: kind of the declared parameter at the same target that it changes too (a mass);
        empty for none.
      needs: parts of MuJoCo's pipeline without which it does nothing (`<option><flag/>`); see
        `orbisim.effects.flags`.
      common: whether every joint of a machine has it, more or less: all of these are tried at all
        joints together, so that nothing rarer is named for what they do. Such an effect has one
        parameter, to which its force is proportional.
      rarity: logarithm of the odds of the effect on a machine beside those of friction at a joint.
      refines: the simpler effect that no machine with this one lacks, at the same target; without
        it, it has the odds of both (strong heredity; Chipman, Canad. J. Statist. 24, 1996).
      shared: its parameters that the simpler effect has, too, which are not fitted beside that.
      measured_as: what an effect of the measurement changes of a signal; empty for the others.
      family: what effects share that look alike as long as they are not fitted to the end, at the
        same target; empty for none.
      timing: whether it changes when something is seen or done, and nothing else: by the parameter
        `delay`, s.
    """

    name: ClassVar[str]
    kind: ClassVar[TargetKind]
    phrase: ClassVar[str]
    native: ClassVar[bool] = True
    measurement: ClassVar[bool] = False
    structural: ClassVar[bool] = False
    stated: ClassVar[bool] = False
    unranked: ClassVar[bool] = False
    declared_as: ClassVar[str] = ""
    needs: ClassVar[tuple[mujoco.mjtDisableBit, ...]] = ()
    common: ClassVar[bool] = False
    rarity: ClassVar[float] = 0.0
    refines: ClassVar[str] = ""
    shared: ClassVar[tuple[str, ...]] = ()
    measured_as: ClassVar[Literal["", "offset", "scale", "delay", "clock", "law"]] = ""
    family: ClassVar[str] = ""
    timing: ClassVar[bool] = False

    @abc.abstractmethod
    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        """The effect's parameters at a target; the first is the one that reports quote."""

    def neutral(self, model: mujoco.MjModel, target: str) -> Mapping[str, float]:
        """Value of each parameter at which it changes nothing."""
        return {p.name: p.neutral for p in self.parameters(model, target)}

    def units(self, model: mujoco.MjModel, instance: EffectInstance) -> Mapping[str, str]:
        """Unit of each parameter, where it depends on the options too."""
        return {p.name: p.unit for p in self.parameters(model, instance.target)}

    def targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        """Names of everything in the model that can have this effect."""
        if impossible(model, self.needs):
            return ()
        return tuple(name for name in names_of_kind(model, self.kind) if self.possible(model, name))

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Whether this target can have the effect."""
        return True

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        """Writes a native effect into the document."""
        raise InputError(f"{self.name} has no native form in MJCF")

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        """What applies an effect that is not native."""
        raise InputError(f"{self.name} needs no hook")

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        """Candidates for a regression along a measured motion; none if there is no such form."""
        return []

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        """Parameter values from which a search by simulation may start."""
        return [{p.name: p.scale for p in self.parameters(model, target)}]

    def places(
        self, model: mujoco.MjModel, target: str, courses: Sequence[Floats]
    ) -> list[list[Mapping[str, float]]]:
        """Values to begin with where no regression says anything: of each list, the best is one.

        Args:
          courses: positions of the joint in each recording, [T] each.
        """
        return [self.trials(model, target)]

    def equivalents(self, model: mujoco.MjModel, instance: EffectInstance) -> list[EffectInstance]:
        """Other effects that do nearly the same as this one, with the values at which they do."""
        return []

    def elsewhere(
        self, model: mujoco.MjModel, instance: EffectInstance, data: mujoco.MjData
    ) -> list[EffectInstance]:
        """What would do the same at another place if the motion did not tell the places apart, with
        the values at which it would: the same at all other targets.

        Args:
          data: at a recorded pose, its kinematics computed.
        """
        others = (name for name in self.targets(model) if name != instance.target)
        return [dataclasses.replace(instance, target=name) for name in others]

    def parts(self, instance: EffectInstance) -> list[EffectInstance]:
        """Effects that together do exactly the same: itself, or less of it and what it refines."""
        return [instance]

    def odds(self, model: mujoco.MjModel, target: str) -> float:
        """`rarity` at a target."""
        return self.rarity

    def like_parts(self, model: mujoco.MjModel) -> int:
        """How many like parts of the machine may have it, for what every joint has, more or less
        (`common`); 1 for all else, where one that has it says nothing of another."""
        return max(len(self.targets(model)), 1) if self.common else 1

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """Logarithm of the prior density at such values over that at its peak, beside what each of
        its parameters costs; minus infinity for what no machine has.

        Args:
          extent: of the recordings, where they are known: what is periodic must come round twice.
        """
        if not all(np.isfinite(v) for v in instance.values.values()):
            return -np.inf
        known = self.parameters(model, instance.target)
        return sum(p.tail(instance.values[p.name]) for p in known if p.name in instance.values)

    def scaled(self, values: Values, size: float) -> Values:
        """Values of the effect so many times as large; numbers that say where it is stay."""
        return {name: size * value for name, value in values.items()}

    def generalized(
        self, model: mujoco.MjModel, special: EffectInstance, values: Values | None = None
    ) -> list[Values]:
        """Values with which it does about what another effect does, of which it is a more general
        form or a part; none if it is neither.

        Args:
          special: the other. values: of this effect, for what the other does not have.
        """
        return []

    def adds_force(self) -> bool:
        """Whether inverse dynamics shows it where the forces at all joints are recorded: a force
        beside these, which follows from the motion; with which options, says `adds_force_with`."""
        if self.measurement or self.structural or self.stated:
            return False
        return self.kind in ("joint", "body", "world")

    def adds_force_with(self, options: Mapping[str, str]) -> bool:
        """Whether it adds a force (see `adds_force`) with these options."""
        return self.adds_force()

    def stepwise(self, instance: EffectInstance, name: str) -> bool:
        """Whether a small change of a parameter mostly changes nothing, and then all at once: a
        derivative says little about it."""
        return False

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        """Names of the parameters that a fit changes; the others follow from them."""
        return tuple(p.name for p in self.parameters(model, target))

    def sizes(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        """Of these, what says how much of the effect there is, instead of where or how: what has
        the unit of the first parameter, or no parameter's; all if there is none."""
        free = self.free_parameters(model, target)
        known = {p.name: p.unit for p in self.parameters(model, target)}
        first = next(iter(known.values()))
        return tuple(name for name in free if known.get(name, first) == first) or free

    def encode(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        """The free parameters' values from all parameters'."""
        return {name: values[name] for name in self.free_parameters(model, target)}

    def complete(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        """All parameters from the free ones."""
        return values

    def check(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        """Raises if the target or a value is impossible.

        Raises:
          UnknownNameError: the model has no such target.
          InputError: a parameter is missing, unknown or out of bounds.
        """
        names = names_of_kind(model, self.kind)
        if instance.target not in names:
            raise UnknownNameError(self.kind, instance.target, names, f"needed by {self.name}")
        if not self.possible(model, instance.target):
            raise InputError(f"{self.name} is not possible at {self.kind} {instance.target!r}")
        self.check_values(model, instance)

    def check_values(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        """Raises if a value is impossible.

        Raises:
          InputError: a parameter is missing, unknown or out of bounds.
        """
        known = {p.name: p for p in self.parameters(model, instance.target)}
        for name, value in instance.values.items():
            if name not in known:
                raise UnknownNameError(f"parameter of {self.name}", name, known)
            known[name].check(self.name, instance.target, value)
        missing = [
            p.name for p in known.values() if p.omitted is None and p.name not in instance.values
        ]
        if missing:
            raise InputError(f"{self.name} at {instance.target!r} lacks {', '.join(missing)}")


class Hook:
    """Applies an effect that MuJoCo cannot express, in many worlds at once.

    Parameter values may differ between worlds: `values` maps each name to an array [nworld] or to
    a number.

    Attributes:
      derived: names of MjData's position- and velocity-stage fields that it reads.
    """

    derived: frozenset[str] = frozenset()

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = {name: np.asarray(value, np.float64) for name, value in values.items()}

    def value(self, name: str, extra: int = 0) -> Floats:
        """A parameter, with `extra` trailing axes for broadcasting against [nworld, ...]."""
        array = self.values[name]
        return array.reshape(array.shape + (1,) * extra)

    def control(self, inputs: StepInputs) -> None:
        """Changes `inputs.ctrl` in place."""

    def force(self, inputs: StepInputs) -> None:
        """Adds to `inputs.qfrc` and `inputs.xfrc` in place."""

    def fields(self, inputs: StepInputs) -> None:
        """Changes per-world model fields in `inputs.fields` in place."""


@dataclasses.dataclass
class StepInputs:
    """What hooks see and change before a timestep.

    Attributes:
      model: read-only.
      time: [nworld], s. qpos: [nworld, nq]. qvel: [nworld, nv].
      ctrl: [nworld, nu], to be changed in place.
      qfrc: [nworld, nv] generalized forces, to be added to.
      xfrc: [nworld, nbody, 6] forces and torques at the bodies' centres of mass in the world
        frame (force first), to be added to.
      derived: MjData fields that hooks asked for, each [nworld, ...].
      fields: per-world values of model fields that hooks change, each [nworld, ...].
    """

    model: mujoco.MjModel
    time: Floats
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    qfrc: Floats
    xfrc: Floats
    derived: Mapping[str, Floats]
    fields: dict[str, Floats]

    def body_velocity(self, body: int) -> tuple[Floats, Floats]:
        """Angular and linear velocity of a body's centre of mass, world frame, each [nworld, 3].

        `cvel` is the velocity of the frame at the tree's centre of mass: v = v_c + w x r.
        """
        cvel = self.derived["cvel"][:, body]
        root = int(self.model.body_rootid[body])
        arm = self.derived["xipos"][:, body] - self.derived["subtree_com"][:, root]
        return cvel[:, :3], cvel[:, 3:] + cross(cvel[:, :3], arm)


def cross(one: Floats, other: Floats) -> Floats:
    """Cross products of vectors [nworld, 3]; `numpy.cross` takes ten times as long for a few."""
    (a, b, c), (d, e, f) = one.T, other.T
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], axis=1)


BODY_MOTION = frozenset({"cvel", "xipos", "subtree_com"})
"""What `StepInputs.body_velocity` needs."""


_KINDS = {
    "joint": (mujoco.mjtObj.mjOBJ_JOINT, "njnt"),
    "actuator": (mujoco.mjtObj.mjOBJ_ACTUATOR, "nactuator"),
    "body": (mujoco.mjtObj.mjOBJ_BODY, "nbody"),
    "geom": (mujoco.mjtObj.mjOBJ_GEOM, "ngeom"),
    "sensor": (mujoco.mjtObj.mjOBJ_SENSOR, "nsensor"),
}


def only_if(possible: bool) -> float:
    """The logarithm of prior odds of 1, or of 0."""
    return 0.0 if possible else -np.inf


def reach(model: mujoco.MjModel, name: str) -> float:
    """Distance from a body's frame to the farthest of its geoms, children and centre of mass, m."""
    body = index_of(model, "body", name)
    far = [float(np.linalg.norm(model.body_ipos[body]))]
    for geom in np.flatnonzero(model.geom_bodyid == body):
        far.append(float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom]))
    for child in np.flatnonzero(model.body_parentid == body):
        if child != body:
            far.append(float(np.linalg.norm(model.body_pos[child])))
    return max(far)


def joints_above(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """Joints between a body and the world."""
    while body:
        first = int(model.body_jntadr[body])
        yield from range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])


def joints_of(model: mujoco.MjModel, kind: str, name: str) -> tuple[str, ...]:
    """Names of the joints at which what has an effect is: itself, its actuator's, its body's."""
    names = names_of_kind(model, "joint")
    if kind in ("joint", "sensor"):
        return (name,) if name in names else ()
    if kind == "actuator":
        actuator = index_of(model, "actuator", name)
        if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
            return (names[model.actuator_trnid[actuator, 0]],)
    if kind == "body":
        body = index_of(model, "body", name)
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        return tuple(names[first : first + count]) if count else ()
    return ()


def leverage(model: mujoco.MjModel, data: mujoco.MjData, joint: int, place: Floats) -> float:
    """Inertia at a hinge or slide of 1 kg at a place in the world: the square of its distance from
    the axis, m^2, or 1."""
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return 1.0
    arm = np.cross(data.xaxis[joint], place - data.xanchor[joint])
    return float(arm @ arm)


def names_of_kind(model: mujoco.MjModel, kind: str) -> tuple[str, ...]:
    """Names of all joints, actuators ... of a model; unnamed ones as `joint3`."""
    if kind in ("world", "recording"):
        return (kind,)
    code, count = _KINDS[kind]
    return tuple(name_of(model, code, i, kind) for i in range(getattr(model, count)))


def index_of(model: mujoco.MjModel, kind: str, name: str) -> int:
    """The id of a named (or `joint3`-style) element.

    Raises:
      UnknownNameError: there is none.
    """
    known = mujoco.mj_name2id(model, _KINDS[kind][0], name) if kind in _KINDS else -1
    if known >= 0:  # asked often: without the names of all others
        return known
    names = names_of_kind(model, kind)
    if name not in names:
        raise UnknownNameError(kind, name, names)
    return names.index(name)


def spec_element(spec: mujoco.MjSpec, kind: str, name: str) -> Any:
    """The element of a document by name, or by `joint3`-style number in the compiled order."""
    found = getattr(spec, kind)(name)
    if found is not None:
        return found
    elements = getattr(spec, {"body": "bodies"}.get(kind, f"{kind}s"))
    digits = name.removeprefix(kind)
    if digits.isdigit() and int(digits) < len(elements) and not elements[int(digits)].name:
        return elements[int(digits)]
    raise UnknownNameError(kind, name, [e.name for e in elements if e.name])


def joint_unit(model: mujoco.MjModel, target: str, angular: str, linear: str) -> str:
    """The unit that applies to a hinge or to a slide."""
    kind = model.jnt_type[index_of(model, "joint", target)]
    return linear if kind == mujoco.mjtJoint.mjJNT_SLIDE else angular


def actuator_unit(model: mujoco.MjModel, target: str) -> str:
    """Unit of an actuator's output force: N where it pushes along a line, N*m where it turns."""
    actuator = index_of(model, "actuator", target)
    transmission = mujoco.mjtTrn(int(model.actuator_trntype[actuator]))
    number = int(model.actuator_trnid[actuator, 0])
    if transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        kind = mujoco.mjtJoint(int(model.jnt_type[number]))
        turns = kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL)
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            turns = not model.actuator_gear[actuator, :3].any()
    elif transmission == mujoco.mjtTrn.mjTRN_SITE:
        turns = not model.actuator_gear[actuator, :3].any()
    elif transmission == mujoco.mjtTrn.mjTRN_TENDON:
        turns = _tendon_turns(model, number)
    else:
        turns = False
    return "N*m" if turns else "N"


def _tendon_turns(model: mujoco.MjModel, tendon: int) -> bool:
    """Whether a tendon's length is an angle: a fixed tendon of hinges only."""
    first = int(model.tendon_adr[tendon])
    parts = slice(first, first + int(model.tendon_num[tendon]))
    if (model.wrap_type[parts] != mujoco.mjtWrap.mjWRAP_JOINT).any():
        return False
    kinds = model.jnt_type[model.wrap_objid[parts]]
    return bool((kinds == mujoco.mjtJoint.mjJNT_HINGE).all())


def is_scalar_joint(model: mujoco.MjModel, target: str) -> bool:
    """Whether the joint is a hinge or a slide."""
    kind = int(model.jnt_type[index_of(model, "joint", target)])
    return kind in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
