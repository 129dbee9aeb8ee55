"""The state in which the stage says that things start, as a keyframe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from orbisim.scene.usd.actuators import ActuatorBuilder, resting_control, set_gains
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.bodies import Bodies
from orbisim.scene.usd.chains import Element
from orbisim.scene.usd.compiling import compiled
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FloatArray
from orbisim.scene.usd.joints import SLIDE
from orbisim.scene.usd.registry import Registry
from orbisim.scene.usd.tree import Forest
from orbisim.scene.usd.units import DEGREE

KEY = "initial"
_MISFIT = 1e-3  # share of the authored velocities that joints may take away without a word

_KEY_FIELDS = ("qpos", "qvel", "act", "ctrl", "mpos", "mquat")


def add_native_keys(context: Context, spec: mujoco.MjSpec) -> None:
    """Adds `MjcKeyframe` prims whose sizes fit the model."""
    prims = list(context.of_type("MjcKeyframe"))
    if not prims:
        return
    model = compiled(spec, context.source)
    sizes = {
        "qpos": model.nq, "qvel": model.nv, "act": model.na, "ctrl": model.nu,
        "mpos": 3 * model.nmocap, "mquat": 4 * model.nmocap,
    }  # fmt: skip
    for prim in prims:
        values = {name: prim.numbers(f"mjc:{name}", None) for name in _KEY_FIELDS}
        given = {name: value for name, value in values.items() if value is not None and len(value)}
        wrong = [name for name, value in given.items() if len(value) != sizes[name]]
        if wrong:
            context.omit(
                prim.path,
                f"MjcKeyframe with {len(given[wrong[0]])} numbers in mjc:{wrong[0]} "
                f"(the model has {sizes[wrong[0]]})",
                "left out",
            )
            continue
        key = spec.add_key(name=prim.flat.display_name or prim.flat.name)
        for name, value in given.items():
            setattr(key, name, value)


def add_start(
    context: Context,
    registry: Registry,
    bodies: Bodies,
    forest: Forest,
    actuators: ActuatorBuilder,
) -> None:
    """Adds the keyframe "initial" if things start other than at rest with zero controls.

    Also scales the gains of acceleration drives by the inertia that they move, which only the
    compiled model knows.
    """
    states = _joint_states(context, registry, forest)
    balls = [element for link in forest.links for element in link.chain
             if element.start is not None]  # fmt: skip
    moving = any(body.moves for body in bodies.all.values()) or any(
        velocity for _, velocity in states.values()
    )
    placed = bool(balls) or any(position is not None for position, _ in states.values())
    accelerating = any(drive.acceleration for _, _, drive in actuators.driven)
    targets = {actuator.name: resting_control(drive) for actuator, _, drive in actuators.driven}
    commanded = any(targets.values())
    if not (moving or placed or accelerating or commanded):
        return
    model = compiled(registry.spec, context.source)
    _scale_gains(context, model, actuators)
    if not (moving or placed or commanded):
        return
    qpos = _positions(model, registry, balls, states)
    qvel = _velocities(context, model, registry, bodies, qpos) if moving else np.zeros(model.nv)
    for joint, (_, velocity) in states.items():
        if velocity:
            qvel[model.joint(joint).dofadr[0]] = velocity
    ctrl = np.zeros(model.nu)
    for name, target in targets.items():
        ctrl[model.actuator(name).id] = target
    key = registry.spec.add_key(name=KEY)
    key.qpos, key.qvel, key.ctrl = qpos, qvel, ctrl
    what = [
        *(["initial velocities"] if moving else []),
        *(["initial positions"] if placed else []),
        *(["drive targets"] if commanded else []),
    ]
    context.warn(f"{', '.join(what)} are in the keyframe {KEY!r}; MuJoCo itself starts at zero")


def _scale_gains(context: Context, model: mujoco.MjModel, actuators: ActuatorBuilder) -> None:
    """An acceleration drive's gains times the inertia that its joint moves at the start."""
    for actuator, joint, drive in actuators.driven:
        if not drive.acceleration:
            continue
        inverse = float(model.dof_invweight0[model.joint(joint).dofadr[0]])
        inertia = 1.0 / inverse if inverse > 0 else 1.0
        set_gains(actuator, drive, drive.stiffness * inertia, drive.damping * inertia)
        context.omit(
            drive.prim.path,
            "a drive of type 'acceleration'",
            f"its gains are scaled by the inertia in the initial pose, {inertia:.4g}",
        )


def _joint_states(
    context: Context, registry: Registry, forest: Forest
) -> dict[str, tuple[float | None, float]]:
    """Authored joint states by joint name: position (None if it is the authored pose), speed."""
    found: dict[str, tuple[float | None, float]] = {}
    for link in forest.links:
        for element in link.chain:
            chain = [e for e in link.chain if e.joint is element.joint]
            name = registry.joints[element.joint.path][chain.index(element)]
            state = _state(context, element.joint.prim, element)
            if state != (None, 0.0):
                found[name] = state
    return found


def _state(context: Context, prim: Prim, element: Element) -> tuple[float | None, float]:
    unit = context.units.length if element.dof.kind == SLIDE else DEGREE
    stem = f"state:{element.dof.token}:physics:"
    position = prim.number(f"{stem}position", unit)
    velocity = prim.number(f"{stem}velocity", unit)
    if position is not None and abs(position - element.ref) < 1e-5:
        position = None
    return position, velocity or 0.0


def _positions(
    model: mujoco.MjModel,
    registry: Registry,
    balls: Sequence[Element],
    states: Mapping[str, tuple[float | None, float]],
) -> FloatArray:
    qpos: FloatArray = model.qpos0.copy()
    for element in balls:
        for name in registry.joints[element.joint.path]:
            if registry.joint_types[name] == mujoco.mjtJoint.mjJNT_BALL:
                address = model.joint(name).qposadr[0]
                qpos[address : address + 4] = element.start
    for joint, (position, _) in states.items():
        if position is not None:
            qpos[model.joint(joint).qposadr[0]] = position
    return qpos


def _velocities(
    context: Context,
    model: mujoco.MjModel,
    registry: Registry,
    bodies: Bodies,
    qpos: FloatArray,
) -> FloatArray:
    """Generalised velocities that come closest to the authored ones of the bodies.

    Linear velocities are those of the centres of mass, as in the engines that implement
    UsdPhysics.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    rows, wanted = [], []
    for path, body in bodies.all.items():
        index = model.body(registry.bodies[path]).id
        if model.body_mocapid[index] >= 0:
            if body.moves:
                context.omit(path, "velocity of a kinematic body", "it starts at rest")
            continue
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, linear, angular, index)
        rows += [linear, angular]
        wanted += [body.velocity, body.spin]
    if not rows:
        return np.zeros(model.nv)
    jacobian, target = np.concatenate(rows), np.concatenate(wanted)
    qvel, *_ = np.linalg.lstsq(jacobian, target, rcond=1e-10)
    missed = np.linalg.norm(jacobian @ qvel - target)
    if missed > _MISFIT * max(float(np.linalg.norm(target)), 1e-9):
        context.warn("the joints do not allow the authored initial velocities; the closest hold")
    return np.where(np.abs(qvel) < 1e-12, 0.0, qvel)
