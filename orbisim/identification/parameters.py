"""What can be identified: scene descriptors by name, read from a scene and written into it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import mujoco
import numpy as np

from orbisim.effects.base import joint_unit, spec_element
from orbisim.errors import InputError, UnknownNameError
from orbisim.scene import Scene

_LEAST = {"friction": 0.01, "damping": 1e-6, "frictionloss": 1e-6, "armature": 1e-6}
"""What a declared 0 is taken for, since values are searched by their logarithm."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number of a scene.

    Attributes:
      name: see `KINDS`. target: body, geom or joint.
      unit: SI. declared: its value in the scene. low, high: bounds.
    """

    name: str
    target: str
    unit: str
    declared: float
    low: float
    high: float

    @property
    def label(self) -> str:
        """`friction:table`."""
        return f"{self.name}:{self.target}"


@dataclasses.dataclass(frozen=True)
class _Kind:
    """unit: of a joint's property that of a hinge; along: of the same for a slide."""

    unit: str
    low: float
    high: float
    read: Callable[[mujoco.MjModel, str], float]
    write: Callable[[mujoco.MjSpec, mujoco.MjModel, str, float], None]
    along: str = ""

    @property
    def of_joint(self) -> bool:
        return bool(self.along)


def parameters(scene: Scene, wanted: str | Sequence[str]) -> tuple[Parameter, ...]:
    """Parameters of names like `friction:table`; `density` alone means every free body.

    Args:
      scene: that has them.
      wanted: names, separated by commas if in one text; a name without target stands for all free
        bodies, of a joint's property for all hinge and slide joints.

    Raises:
      UnknownNameError: there is no such parameter or target.
      InputError: nothing is named, or a body has no volume of its own.
    """
    names = wanted.split(",") if isinstance(wanted, str) else list(wanted)
    found: dict[str, Parameter] = {}
    for text in (name.strip() for name in names):
        if not text:
            continue
        name, _, target = text.partition(":")
        if name not in KINDS:
            raise UnknownNameError("parameter", name, KINDS)
        targets = [target] if target else _targets(scene.model, KINDS[name])
        if not targets:
            raise InputError(f"{text}: {scene.source} has nothing with this property")
        for one in targets:
            parameter = _parameter(scene.model, name, one)
            found[parameter.label] = parameter
    if not found:
        raise InputError("no parameter is named: give --params friction:table,density:cube1")
    return tuple(found.values())


def patched(scene: Scene, values: Mapping[Parameter, float]) -> Scene:
    """The scene with other values of parameters."""
    spec = scene.spec
    for parameter, value in values.items():
        KINDS[parameter.name].write(spec, scene.model, parameter.target, float(value))
    return Scene.from_spec(spec, source=scene.source)


def free_bodies(model: mujoco.MjModel) -> list[str]:
    """Names of bodies with a free joint."""
    free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    return [model.body(int(body)).name for body in model.jnt_bodyid[free]]


def _parameter(model: mujoco.MjModel, name: str, target: str) -> Parameter:
    kind = KINDS[name]
    value = max(kind.read(model, target), _LEAST.get(name, 0.0))
    low, high = (kind.low, kind.high) if kind.high else (value / 10, value * 10)
    unit = joint_unit(model, target, kind.unit, kind.along) if kind.of_joint else kind.unit
    return Parameter(name, target, unit, value, low, high)


def _targets(model: mujoco.MjModel, kind: _Kind) -> list[str]:
    if not kind.of_joint:
        return free_bodies(model)
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    return [model.joint(j).name for j in range(model.njnt) if int(model.jnt_type[j]) != free]


def _geoms(model: mujoco.MjModel, target: str) -> list[int]:
    """The solid geoms of a body, or the geom of this name."""
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, target)
    if body > 0:
        geoms = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
        solid = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
        if solid:
            return solid
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, target)
    if geom < 0:
        names = [model.geom(g).name for g in range(model.ngeom)] + free_bodies(model)
        raise UnknownNameError("geom or body", target, sorted({n for n in names if n}))
    return [geom]


def _read_friction(model: mujoco.MjModel, target: str) -> float:
    return float(model.geom_friction[_geoms(model, target)[0], 0])


def _write_friction(spec: mujoco.MjSpec, model: mujoco.MjModel, target: str, value: float) -> None:
    for geom in _geoms(model, target):
        spec_element(spec, "geom", model.geom(geom).name or f"geom{geom}").friction[0] = value


def _body(model: mujoco.MjModel, target: str) -> int:
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, target)
    if body <= 0 or not model.body_mass[body] > 0:
        known = [model.body(b).name for b in range(1, model.nbody) if model.body_mass[b] > 0]
        raise UnknownNameError("body with a mass", target, known)
    return int(body)


def _volume(model: mujoco.MjModel, target: str) -> float:
    """m^3, of a body's geoms; meshes are left to their mass."""
    total = 0.0
    shapes = {
        int(mujoco.mjtGeom.mjGEOM_BOX): lambda s: 8 * s[0] * s[1] * s[2],
        int(mujoco.mjtGeom.mjGEOM_SPHERE): lambda s: 4 / 3 * np.pi * s[0] ** 3,
        int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): lambda s: 4 / 3 * np.pi * s[0] * s[1] * s[2],
        int(mujoco.mjtGeom.mjGEOM_CYLINDER): lambda s: 2 * np.pi * s[0] ** 2 * s[1],
        int(mujoco.mjtGeom.mjGEOM_CAPSULE): lambda s: (
            2 * np.pi * s[0] ** 2 * s[1] + 4 / 3 * np.pi * s[0] ** 3
        ),
    }
    for geom in _geoms(model, target):
        kind = int(model.geom_type[geom])
        if kind not in shapes:
            raise InputError(f"density:{target}: the body has a mesh; identify its mass instead")
        total += float(shapes[kind](model.geom_size[geom]))
    return total


def _read_mass(model: mujoco.MjModel, target: str) -> float:
    return float(model.body_mass[_body(model, target)])


def _write_mass(spec: mujoco.MjSpec, model: mujoco.MjModel, target: str, value: float) -> None:
    """Mass and, in proportion, inertia; as an explicit inertial."""
    number = _body(model, target)
    body, ratio = spec_element(spec, "body", target), value / float(model.body_mass[number])
    body.explicitinertial = True
    body.mass = value
    body.ipos, body.iquat = model.body_ipos[number].copy(), model.body_iquat[number].copy()
    body.inertia = model.body_inertia[number] * ratio
    body.fullinertia = np.full(6, np.nan)


def _read_density(model: mujoco.MjModel, target: str) -> float:
    return _read_mass(model, target) / _volume(model, target)


def _write_density(spec: mujoco.MjSpec, model: mujoco.MjModel, target: str, value: float) -> None:
    _write_mass(spec, model, target, value * _volume(model, target))


def _of_joint(field: str, unit: str, along: str) -> _Kind:
    """A number of joints."""

    def read(model: mujoco.MjModel, target: str) -> float:
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, target)
        if joint < 0:
            names = [model.joint(j).name for j in range(model.njnt)]
            raise UnknownNameError("joint", target, names)
        return float(getattr(model, f"dof_{field}")[model.jnt_dofadr[joint]])

    def write(spec: mujoco.MjSpec, model: mujoco.MjModel, target: str, value: float) -> None:
        joint = spec_element(spec, "joint", target)
        now = getattr(joint, field)
        if np.ndim(now):  # a polynomial whose first term it is
            now[0] = value
        else:
            setattr(joint, field, value)

    return _Kind(unit, 1e-7, 1e3, read, write, along)


KINDS: dict[str, _Kind] = {
    "friction": _Kind("1", 0.01, 3.0, _read_friction, _write_friction),
    "density": _Kind("kg/m^3", 10.0, 20_000.0, _read_density, _write_density),
    "mass": _Kind("kg", 0.0, 0.0, _read_mass, _write_mass),
    **{
        name: _of_joint(name, unit, along)
        for name, unit, along in (
            ("damping", "N*m*s/rad", "N*s/m"),
            ("frictionloss", "N*m", "N"),
            ("armature", "kg*m^2", "kg"),
        )
    },
}
"""By name: sliding friction of a geom or a body's geoms, density and mass of a body, and damping,
dry friction and armature of a joint."""
