"""Effects on bodies and on the world."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from orbisim.effects.base import (
    AXES,
    BODY_MOTION,
    LARGE,
    Effect,
    EffectInstance,
    Extent,
    Hook,
    Parameter,
    StepInputs,
    Values,
    cross,
    index_of,
    is_scalar_joint,
    joint_unit,
    joints_above,
    leverage,
    names_of_kind,
    only_if,
    reach,
    spec_element,
)
from orbisim.effects.contacts import pressed
from orbisim.effects.screening import (
    Candidate,
    Column,
    Floats,
    MotionRegressors,
    Solve,
    keyed,
    positive,
)
from orbisim.effects.servo_offsets import same_offsets

_INSIDE = -2.0
"""Log odds of a load on a body that others hang on, beside one at an end."""
_BEYOND = 1.5
"""Something fixed to a body may stick out of it by half its reach."""


class BodyEffect(Effect):
    """An effect on a body that can move."""

    kind = "body"

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Bodies with a joint, or welded to one that has."""
        body = index_of(model, "body", target)
        return bool(model.body_weldid[body] != 0 and model.body_mass[body] > 0)


class Payload(BodyEffect):
    """A point mass fixed to the body: a child body with `inertial`."""

    name = "payload"
    phrase = "a payload"
    declared_as = "mass"
    family = "mass"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        reach = [Parameter(f"com_{axis}", "m", -10.0, 10.0, 0.1) for axis in AXES]
        return (Parameter("mass", "kg", -LARGE, LARGE, 0.2), *reach)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        body = spec_element(spec, "body", instance.target)
        position = np.array([instance.values[f"com_{axis}"] for axis in AXES])
        add_point_mass(spec, body, instance.values["mass"], position)

    def odds(self, model: mujoco.MjModel, target: str) -> float:
        """Loads sit at the ends of a machine."""
        return 0.0 if index_of(model, "body", target) not in model.body_parentid else _INSIDE

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """A machine carries at most twice its own mass, fixed to the body or near it."""
        values = instance.values
        place = float(np.linalg.norm([values[f"com_{axis}"] for axis in AXES]))
        near = place <= _BEYOND * reach(model, instance.target)
        return only_if(near and values["mass"] <= 2 * float(model.body_mass.sum()))

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        """1 kg at the frame's origin, and its first and second moments about it."""
        columns = (
            _inertia(view, target, np.zeros(3)),
            *_first_moments(view, target),
            *_second_moments(view, target),
        )

        def solve(c: Floats) -> dict[str, float] | None:
            if c[0] <= 0:
                return None
            place = np.clip(c[1:4] / c[0], -2.0, 2.0)
            return {
                "mass": float(c[0]),
                **dict(zip(("com_x", "com_y", "com_z"), map(float, place), strict=True)),
            }

        whole = Candidate(self.name, target, columns, solve)
        return [whole, *(self._at(view, target, place) for place in _places(view.model, target))]

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        """A tenth and a third of the body's mass at its centre of mass."""
        body = index_of(model, "body", target)
        place = dict(
            zip(("com_x", "com_y", "com_z"), map(float, model.body_ipos[body]), strict=True)
        )
        return [{"mass": share * float(model.body_mass[body]), **place} for share in _SHARES]

    def scaled(self, values: Values, size: float) -> Values:
        """Another mass at the same place."""
        return {**values, "mass": size * values["mass"]}

    def generalized(
        self, model: mujoco.MjModel, special: EffectInstance, values: Values | None = None
    ) -> list[Values]:
        """Masses of a tenth of the body's to twice as much, each where it moves the centre of mass
        as the offset does."""
        if special.effect != ComOffset.name:
            return []
        body = index_of(model, "body", special.target)
        offset = np.array([special.values[axis] for axis in AXES])
        found: list[Values] = []
        for share in (*_SHARES, 1.0, 2.0):
            place = model.body_ipos[body] + offset * (1 + 1 / share)
            parts = dict(zip(("com_x", "com_y", "com_z"), map(float, place), strict=True))
            found.append({"mass": share * float(model.body_mass[body]), **parts})
        return found

    def elsewhere(
        self, model: mujoco.MjModel, instance: EffectInstance, data: mujoco.MjData
    ) -> list[EffectInstance]:
        """The mass at the same place, fixed to another body; and rotors of as much inertia as it
        has about the joints that carry it."""
        own, mass = index_of(model, "body", instance.target), instance.values["mass"]
        com = np.array([instance.values[f"com_{axis}"] for axis in AXES])
        place = data.xpos[own] + data.xmat[own].reshape(3, 3) @ com
        found = []
        for body, name in _movable(model, own):
            at = data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body])
            parts = dict(zip(("com_x", "com_y", "com_z"), map(float, at), strict=True))
            found.append(EffectInstance(self.name, name, {"mass": mass, **parts}))
        for joint in joints_above(model, own):
            name = names_of_kind(model, "joint")[joint]
            if is_scalar_joint(model, name):
                inertia = mass * leverage(model, data, joint, place)
                found.append(EffectInstance("armature", name, {"inertia": inertia}))
        return found

    def _at(self, view: MotionRegressors, target: str, place: np.ndarray) -> Candidate:
        """A point mass at a known place."""
        parts = dict(zip(("com_x", "com_y", "com_z"), map(float, place), strict=True))

        def solve(c: Floats) -> dict[str, float] | None:
            return {"mass": float(c[0]), **parts} if c[0] > 0 else None

        return Candidate(self.name, target, (_inertia(view, target, place),), solve, shape=1)


def _movable(model: mujoco.MjModel, own: int) -> list[tuple[int, str]]:
    """Other bodies of the same tree with joints: what is welded to one is a part of it."""
    names, weld = names_of_kind(model, "body"), model.body_weldid
    same = np.flatnonzero((model.body_rootid == model.body_rootid[own]) & (model.body_mass > 0))
    return [(int(b), names[b]) for b in same if weld[b] == b and weld[own] != b]


def _places(model: mujoco.MjModel, target: str) -> list[np.ndarray]:
    """Where on a body something may sit: its centre of mass, its geoms, its children."""
    body = index_of(model, "body", target)
    found = [model.body_ipos[body]]
    found += [model.geom_pos[g] for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    found += [model.body_pos[b] for b in range(1, model.nbody) if model.body_parentid[b] == body]
    distinct: list[np.ndarray] = []
    for place in found:
        if all(np.linalg.norm(place - other) > 1e-3 for other in distinct):
            distinct.append(np.array(place))
    return distinct[:_MOST_PLACES]


_MOST_PLACES = 6
"""Each is a suspect of its own; places of further geoms are close to one of these."""
_SHARES = (0.1, 0.3)


class ComOffset(BodyEffect):
    """The centre of mass lies elsewhere in the body than declared."""

    name = "com_offset"
    rarity = -1.0
    phrase = "an offset of the centre of mass"
    family = "mass"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        parts = [Parameter(axis, "m", -10.0, 10.0, 0.02) for axis in AXES]
        return (Parameter("offset", "m", 0.0, 20.0, 0.02), *parts)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        body = spec_element(spec, "body", instance.target)
        mass, pos, quat, inertia = inertial_of(spec, instance.target)
        offset = np.array([instance.values[axis] for axis in AXES])
        write_inertial(body, mass, pos + offset, quat, inertia)

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        return AXES

    def complete(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        return {"offset": _norm(values), **{axis: values[axis] for axis in AXES}}

    def generalized(
        self, model: mujoco.MjModel, special: EffectInstance, values: Values | None = None
    ) -> list[Values]:
        """The offset at which the centre of mass is with a payload."""
        if special.effect != Payload.name:
            return []
        body, mass = index_of(model, "body", special.target), special.values["mass"]
        place = np.array([special.values[name] for name in ("com_x", "com_y", "com_z")])
        offset = (place - model.body_ipos[body]) * mass / (mass + float(model.body_mass[body]))
        parts = dict(zip(AXES, offset.tolist(), strict=True))
        return [self.complete(model, special.target, parts)]

    def elsewhere(
        self, model: mujoco.MjModel, instance: EffectInstance, data: mujoco.MjData
    ) -> list[EffectInstance]:
        """Offsets of other bodies that move the centre of all mass as far the same way."""
        own = index_of(model, "body", instance.target)
        moment = np.array([instance.values[axis] for axis in AXES]) * model.body_mass[own]
        moment = data.xmat[own].reshape(3, 3) @ moment
        found = []
        for body, name in _movable(model, own):
            offset = data.xmat[body].reshape(3, 3).T @ moment / model.body_mass[body]
            values = self.complete(model, name, dict(zip(AXES, offset.tolist(), strict=True)))
            found.append(EffectInstance(self.name, name, dict(values)))
        return found

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """A centre of mass lies within the reach of its body."""
        return only_if(instance.values["offset"] <= reach(model, instance.target))

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        mass = float(view.model.body_mass[index_of(view.model, "body", target)])
        columns = tuple(
            Column("force", mass * column.values) for column in _first_moments(view, target)
        )
        return [Candidate(self.name, target, columns, _vector("offset"))]


class Buoyancy(BodyEffect):
    """The weight of a displaced mass, upwards at the centre of mass: MJCF `gravcomp`."""

    name = "buoyancy"
    rarity = -3.0
    phrase = "buoyancy"
    family = "force"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("displaced_mass", "kg", 0.0, LARGE, 0.1),)

    def equivalents(self, model: mujoco.MjModel, instance: EffectInstance) -> list[EffectInstance]:
        """Less friction of a free body, on which less weight presses then."""
        lift = instance.values["displaced_mass"] * float(np.linalg.norm(model.opt.gravity))
        return pressed(model, instance.target, -lift)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        body = spec_element(spec, "body", instance.target)
        mass = inertial_of(spec, instance.target)[0]
        body.gravcomp += instance.values["displaced_mass"] / mass

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """A body displaces at most twice its own mass."""
        mass = float(model.body_mass[index_of(model, "body", instance.target)])
        return only_if(instance.values["displaced_mass"] <= 2 * mass)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        motion = view.body_motion(index_of(view.model, "body", target))
        lift = motion.force(-np.asarray(view.model.opt.gravity))
        return [Candidate(self.name, target, (Column("force", lift),), positive("displaced_mass"))]

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        """A tenth and a third of the body's mass."""
        mass = float(model.body_mass[index_of(model, "body", target)])
        return [{"displaced_mass": share * mass} for share in _SHARES]


class ConstantForce(BodyEffect):
    """A force of constant size and direction in the world, at the centre of mass."""

    name = "constant_force"
    rarity = -4.0
    phrase = "a constant force"
    family = "force"
    native = False

    def equivalents(self, model: mujoco.MjModel, instance: EffectInstance) -> list[EffectInstance]:
        """Offsets of servos along it, and friction of a free body that it presses down."""
        force, gravity = np.array([instance.values[axis] for axis in AXES]), model.opt.gravity
        down = float(force @ gravity) / max(float(np.linalg.norm(gravity)), 1e-300)
        mostly = down**2 > 0.5 * float(force @ force)
        return [
            *same_offsets(model, instance),
            *(pressed(model, instance.target, down) if mostly else []),
        ]

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        parts = [Parameter(axis, "N", -LARGE, LARGE, 1.0) for axis in AXES]
        return (Parameter("magnitude", "N", 0.0, 2 * LARGE, 1.0), *parts)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _ConstantForce(model, instance)

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        return AXES

    def complete(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        return {"magnitude": _norm(values), **{axis: values[axis] for axis in AXES}}

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        motion = view.body_motion(index_of(view.model, "body", target))
        columns = tuple(Column("force", motion.force(axis)) for axis in np.eye(3))
        return [Candidate(self.name, target, columns, _vector("magnitude"))]

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        """A tenth of 1 g times the body's mass along each axis, there and back."""
        size = float(model.body_mass[index_of(model, "body", target)])
        found = (sign * size * axis for axis in np.eye(3) for sign in (1.0, -1.0))
        return [{"magnitude": size, **dict(zip(AXES, map(float, f), strict=True))} for f in found]


class PeriodicDisturbance(Effect):
    """A sin(2 pi f t + phase): a torque or force at a joint, or a force on a body (with the options
    x, y, z of its direction in the world).
    """

    name = "periodic_disturbance"
    rarity = -3.0
    kind = "joint"
    phrase = "a periodic disturbance"
    native = False

    def targets(self, model: mujoco.MjModel) -> tuple[str, ...]:
        joints = [n for n in names_of_kind(model, "joint") if is_scalar_joint(model, n)]
        free = [
            name
            for body, name in enumerate(names_of_kind(model, "body"))
            if model.body_jntnum[body] == 1
            and model.jnt_type[model.body_jntadr[body]] == mujoco.mjtJoint.mjJNT_FREE
        ]
        return (*joints, *(name for name in free if name not in joints))

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        joint = target in names_of_kind(model, "joint")
        unit = joint_unit(model, target, "N*m", "N") if joint else "N"
        return (
            Parameter("amplitude", unit, 0.0, LARGE, 0.1),
            Parameter("frequency", "Hz", 1e-3, 1e4, 2.0),
            Parameter("phase", "rad", -10.0, 10.0, 0.0),
        )

    def check(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        """As `Effect.check`; the target is a joint or a body."""
        if instance.target in names_of_kind(model, "joint"):
            super().check(model, instance)
            return
        index_of(model, "body", instance.target)
        self.check_values(model, instance)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Periodic(model, instance)

    def log_prior(
        self, model: mujoco.MjModel, instance: EffectInstance, extent: Extent | None = None
    ) -> float:
        """It has come round twice."""
        enough = extent is None or instance.values["frequency"] * extent.duration >= 2
        return only_if(enough)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        model = view.model
        if target not in names_of_kind(model, "joint"):
            return self._on_body(view, target)
        dof = int(model.jnt_dofadr[index_of(model, "joint", target)])
        unit = np.zeros((len(view.time), model.nv))
        unit[:, dof] = 1.0
        return [
            Candidate(self.name, target, _waves(view, f, unit), _wave_values(f), shape=1)
            for f in view.spectrum_peaks(dof, "time")
        ]

    def _on_body(self, view: MotionRegressors, target: str) -> list[Candidate]:
        """Along each axis of the world in turn."""
        model = view.model
        body = index_of(model, "body", target)
        motion = view.body_motion(body)
        first = int(model.jnt_dofadr[model.body_jntadr[body]])
        found: list[Candidate] = []
        for axis, name in enumerate(AXES):
            unit = motion.force(np.eye(3)[axis])
            options = {a: str(float(a == name)) for a in AXES}
            found += [
                Candidate(
                    self.name, target, _waves(view, f, unit), _wave_values(f), options, shape=1
                )
                for f in view.spectrum_peaks(first + axis, "time")
            ]
        return found


class LinearDrag(BodyEffect):
    """A force -c v at the centre of mass."""

    name = "linear_drag"
    rarity = -3.0
    phrase = "linear drag"
    family = "drag"
    native = False

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("coefficient", "N*s/m", 0.0, LARGE, 0.05),)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Drag(model, instance, power=0)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        motion = view.body_motion(index_of(view.model, "body", target))
        column = Column("force", motion.force(-motion.velocity))
        return [Candidate(self.name, target, (column,), positive("coefficient"))]


class QuadraticDrag(BodyEffect):
    """A force -c v |v| at the centre of mass."""

    name = "quadratic_drag"
    rarity = -2.0
    phrase = "quadratic drag"
    family = "drag"
    native = False

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("coefficient", "N*s^2/m^2", 0.0, LARGE, 0.01),)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Drag(model, instance, power=1)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        motion = view.body_motion(index_of(view.model, "body", target))
        speed = np.linalg.norm(motion.velocity, axis=1, keepdims=True)
        column = Column("force", motion.force(-speed * motion.velocity))
        return [Candidate(self.name, target, (column,), positive("coefficient"))]


class Magnus(BodyEffect):
    """A force c (w x v) at the centre of mass of a spinning body."""

    name = "magnus"
    phrase = "a Magnus force"
    native = False

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Free bodies: others do not spin through a medium."""
        body = index_of(model, "body", target)
        joint = model.body_jntadr[body]
        free = joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        return bool(free and super().possible(model, target))

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("coefficient", "kg", -LARGE, LARGE, 1e-3),)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Magnus(model, instance)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        motion = view.body_motion(index_of(view.model, "body", target))
        column = Column("force", motion.force(np.cross(motion.spin, motion.velocity)))
        return [Candidate(self.name, target, (column,), keyed("coefficient"))]


class GravityTilt(Effect):
    """Gravity has another direction: MJCF `gravity`, of the declared magnitude."""

    name = "gravity_tilt"
    rarity = -2.0
    kind = "world"
    phrase = "a tilt against gravity"
    needs = (mujoco.mjtDisableBit.mjDSBL_GRAVITY,)

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Scenes with gravity."""
        return bool(np.linalg.norm(model.opt.gravity) > 0)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        parts = [Parameter(axis, "m/s^2", -100.0, 100.0, 0.5) for axis in AXES]
        return (Parameter("angle", "deg", 0.0, 180.0, 3.0, usual=_TILTED), *parts)

    def neutral(self, model: mujoco.MjModel, target: str) -> Values:
        """The declared direction."""
        return {"angle": 0.0, **dict(zip(AXES, map(float, model.opt.gravity), strict=True))}

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        """A quarter of what is usual, to four sides."""
        size = float(np.tan(np.radians(_TILTED / 4.0)))
        return [
            self.complete(model, target, {"tilt_1": size * first, "tilt_2": size * second})
            for first, second in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
        ]

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        spec.option.gravity = [instance.values[axis] for axis in AXES]

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        return ("tilt_1", "tilt_2")

    def encode(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        """Tangents of the tilt along two horizontal directions."""
        gravity = np.asarray(model.opt.gravity)
        tilted = np.array([values[axis] for axis in AXES])
        down = gravity / np.linalg.norm(gravity)
        parts = _across(gravity) @ tilted / (tilted @ down)
        return {"tilt_1": float(parts[0]), "tilt_2": float(parts[1])}

    def complete(self, model: mujoco.MjModel, target: str, values: Values) -> Values:
        gravity = np.asarray(model.opt.gravity)
        size = float(np.linalg.norm(gravity))
        across = _across(gravity)
        tilted = gravity / size + values["tilt_1"] * across[0] + values["tilt_2"] * across[1]
        tilted *= size / np.linalg.norm(tilted)
        angle = np.degrees(np.arctan(np.hypot(values["tilt_1"], values["tilt_2"])))
        return {"angle": float(angle), **dict(zip(AXES, map(float, tilted), strict=True))}

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        model = view.model
        size = float(np.linalg.norm(model.opt.gravity))
        columns = []
        for direction in _across(np.asarray(model.opt.gravity)):
            force = np.zeros((len(view.time), model.nv))
            for body in range(1, model.nbody):
                if model.body_weldid[body] and model.body_mass[body] > 0:
                    weight = float(model.body_mass[body]) * size * direction
                    force += view.body_motion(body).force(weight)
            columns.append(Column("force", force))
        return [Candidate(self.name, target, tuple(columns), keyed("tilt_1", "tilt_2"))]


_TILTED = 2.0
"""Degrees: tables and floors are level to about one, what is mounted by hand to a few."""


def _norm(values: Values) -> float:
    return float(np.linalg.norm([values[axis] for axis in AXES]))


def _vector(first: str) -> Solve:
    """Coefficients as x, y, z, and their norm as the first parameter."""

    def solve(c: Floats) -> dict[str, float]:
        parts = dict(zip(AXES, map(float, c), strict=True))
        return {first: _norm(parts), **parts}

    return solve


def _across(gravity: Floats) -> Floats:
    """Two unit vectors perpendicular to gravity."""
    down = gravity / np.linalg.norm(gravity)
    helper = np.eye(3)[int(np.argmin(np.abs(down)))]
    first = helper - down * (helper @ down)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first)])


def _inertia(view: MotionRegressors, body: str, place: Floats) -> Column:
    motion = view.body_motion(index_of(view.model, "body", body))
    return Column("force", motion.point_inertia(place))


def _first_moments(view: MotionRegressors, body: str) -> tuple[Column, ...]:
    """The part of a point mass's inertia that is linear in its place."""
    motion = view.body_motion(index_of(view.model, "body", body))
    return tuple(
        Column("force", 0.5 * (motion.point_inertia(axis) - motion.point_inertia(-axis)))
        for axis in np.eye(3)
    )


def _second_moments(view: MotionRegressors, body: str) -> tuple[Column, ...]:
    """The part of a point mass's inertia that is quadratic in its place."""
    motion = view.body_motion(index_of(view.model, "body", body))
    origin = motion.point_inertia(np.zeros(3))

    def even(place: Floats) -> Floats:
        both = motion.point_inertia(place) + motion.point_inertia(-place)
        return np.asarray(0.5 * both - origin)

    squares = [even(axis) for axis in np.eye(3)]
    found = [Column("force", square) for square in squares]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        mixed = even(np.eye(3)[i] + np.eye(3)[j]) - squares[i] - squares[j]
        found.append(Column("force", mixed))
    return tuple(found)


def _waves(view: MotionRegressors, frequency: float, unit: Floats) -> tuple[Column, Column]:
    phase = 2 * np.pi * frequency * view.time
    return (
        Column("force", np.sin(phase)[:, None] * unit),
        Column("force", np.cos(phase)[:, None] * unit),
    )


def _wave_values(frequency: float) -> Solve:
    def solve(c: Floats) -> dict[str, float]:
        return {
            "amplitude": float(np.hypot(c[0], c[1])),
            "frequency": float(frequency),
            "phase": float(np.arctan2(c[1], c[0])),
        }

    return solve


# ---------------------------------------------------------------------------------------------
# Hooks


class _BodyHook(Hook):
    derived = BODY_MOTION

    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        self._body = index_of(model, "body", instance.target)


class _ConstantForce(_BodyHook):
    derived = frozenset()

    def force(self, inputs: StepInputs) -> None:
        for axis, name in enumerate(AXES):
            inputs.xfrc[:, self._body, axis] += self.value(name)


class _Drag(_BodyHook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance, power: int) -> None:
        super().__init__(model, instance)
        self._power = power

    def force(self, inputs: StepInputs) -> None:
        _, velocity = inputs.body_velocity(self._body)
        speed = np.linalg.norm(velocity, axis=1, keepdims=True) ** self._power
        inputs.xfrc[:, self._body, :3] -= self.value("coefficient", 1) * speed * velocity


class _Magnus(_BodyHook):
    def force(self, inputs: StepInputs) -> None:
        spin, velocity = inputs.body_velocity(self._body)
        lift = self.value("coefficient", 1) * cross(spin, velocity)
        inputs.xfrc[:, self._body, :3] += lift


class _Periodic(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        self._direction: np.ndarray | None = None
        if instance.target in names_of_kind(model, "joint"):
            joint = index_of(model, "joint", instance.target)
            self._index = int(model.jnt_dofadr[joint])
        else:
            self._index = index_of(model, "body", instance.target)
            direction = np.array([float(instance.options.get(a, "0")) for a in AXES])
            norm = np.linalg.norm(direction)
            self._direction = direction / norm if norm else np.array([0.0, 0.0, 1.0])

    def force(self, inputs: StepInputs) -> None:
        phase = 2 * np.pi * self.value("frequency") * inputs.time + self.value("phase")
        push = self.value("amplitude") * np.sin(phase)
        if self._direction is None:
            inputs.qfrc[:, self._index] += push
        else:
            inputs.xfrc[:, self._index, :3] += push[:, None] * self._direction


# ---------------------------------------------------------------------------------------------
# Inertia in a document


def inertial_of(spec: mujoco.MjSpec, name: str) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Mass, centre of mass, principal axes and moments of a body as the compiler has them."""
    model = spec.copy().compile()
    body = index_of(model, "body", name)
    return (
        float(model.body_mass[body]),
        model.body_ipos[body].copy(),
        model.body_iquat[body].copy(),
        model.body_inertia[body].copy(),
    )


def write_inertial(
    body: object, mass: float, pos: np.ndarray, quat: np.ndarray, inertia: np.ndarray
) -> None:
    """Makes the body's inertia explicit."""
    for name, value in (
        ("explicitinertial", True),
        ("mass", mass),
        ("ipos", pos),
        ("iquat", quat),
        ("inertia", inertia),
        ("fullinertia", np.full(6, np.nan)),  # not given
    ):
        setattr(body, name, value)


def add_point_mass(spec: mujoco.MjSpec, body: object, mass: float, position: np.ndarray) -> None:
    """Merges a point mass into a body's inertia (parallel axes); it may be negative."""
    name = str(getattr(body, "name", ""))
    own, com, quat, moments = inertial_of(spec, name)
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, quat)
    axes = frame.reshape(3, 3)
    tensor = axes @ np.diag(moments) @ axes.T
    total = own + mass
    centre = (own * com + mass * position) / total
    for part, at in ((own, com), (mass, position)):
        arm = at - centre
        tensor = tensor + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    moments, vectors = np.linalg.eigh(tensor)
    if np.linalg.det(vectors) < 0:
        vectors[:, 0] *= -1
    rotation = np.zeros(4)
    mujoco.mju_mat2Quat(rotation, vectors.ravel())
    write_inertial(body, total, centre, rotation, moments)
