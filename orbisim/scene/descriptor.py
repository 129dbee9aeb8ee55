"""Static descriptors: what a scene is made of, in MuJoCo's vocabulary and units.

A `SceneDescriptor` is a view of the compiled model: entities (robots, rigid and articulated
objects, deformables, the static surroundings), each with parts, geometries and joints, the
actuators, and the world configuration. The learned models are conditioned on it, system
identification optimises it, and `orbisim info` prints it.

Every numeric field carries its width in its dataclass metadata, so that a descriptor can be
written to tensors and read back without loss (`orbisim.scene.tensors`).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any, Literal

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import UnknownNameError
from orbisim.scene.surface import Surface, sample_geom_surface, sample_mesh_surface

EntityKind = Literal["robot", "rigid_object", "articulated_object", "deformable", "static"]


def _number(unit: str = "1") -> Any:
    return dataclasses.field(metadata={"width": 1, "unit": unit})


def _vector(width: int, unit: str = "1") -> Any:
    return dataclasses.field(metadata={"width": width, "unit": unit})


@dataclasses.dataclass(frozen=True)
class GeometryDescriptor:
    """One geom.

    Attributes:
      name: the geom's name, or `geom<id>`.
      type: plane, hfield, sphere, capsule, ellipsoid, cylinder, box, mesh or sdf.
      size: MuJoCo's `size` in m (meaning depends on `type`; half sizes of the bounding box for
        meshes and height fields).
      pos, quat: frame relative to the part, m and (w, x, y, z).
      friction: sliding (1), torsional (m), rolling (m) coefficients.
      solref, solimp: contact solver parameters.
      margin, gap: contact detection margin and gap, m.
      rgba: colour.
      condim: dimension of the contact's friction cone (1, 3, 4, 6).
      contype, conaffinity: collision bit masks; both 0 for a visual geom.
      mesh: name of the mesh asset, if any.
      surface: points and normals sampled from the surface, in the geom's frame; meshes and
        height fields only (a primitive is given by `type` and `size`).
    """

    name: str
    type: str
    size: tuple[float, ...] = _vector(3, "m")
    pos: tuple[float, ...] = _vector(3, "m")
    quat: tuple[float, ...] = _vector(4)
    friction: tuple[float, ...] = _vector(3)
    solref: tuple[float, ...] = _vector(2)
    solimp: tuple[float, ...] = _vector(5)
    margin: float = _number("m")
    gap: float = _number("m")
    rgba: tuple[float, ...] = _vector(4)
    condim: int = 3
    contype: int = 1
    conaffinity: int = 1
    mesh: str | None = None
    surface: Surface | None = None

    @property
    def collides(self) -> bool:
        """Whether the geom can take part in contacts by its bit masks."""
        return bool(self.contype or self.conaffinity)


@dataclasses.dataclass(frozen=True)
class JointDescriptor:
    """One joint.

    Attributes:
      name: the joint's name, or `joint<id>`.
      type: free, ball, slide or hinge.
      parent, child: bodies that it connects.
      limited: whether `range` is enforced.
      axis: in the child's frame (slide and hinge).
      pos: anchor in the child's frame, m.
      range: limits, rad or m; (0, 0) when unlimited.
      ref, springref: position at which the model was drawn; rest position of the spring.
      stiffness, damping: polynomial coefficients, (linear, quadratic, cubic).
      frictionloss: dry friction, N*m or N.
      armature: reflected inertia, kg*m^2 or kg.
    """

    name: str
    type: str
    parent: str
    child: str
    limited: bool
    axis: tuple[float, ...] = _vector(3)
    pos: tuple[float, ...] = _vector(3, "m")
    range: tuple[float, ...] = _vector(2, "rad or m")
    ref: float = _number("rad or m")
    springref: float = _number("rad or m")
    stiffness: tuple[float, ...] = _vector(3, "N*m/rad or N/m")
    damping: tuple[float, ...] = _vector(3, "N*m*s/rad or N*s/m")
    frictionloss: float = _number("N*m or N")
    armature: float = _number("kg*m^2 or kg")


@dataclasses.dataclass(frozen=True)
class PartDescriptor:
    """One body.

    Attributes:
      name: the body's name, or `body<id>`.
      parent: name of the parent body; None for the world itself.
      pos, quat: frame relative to the parent, m and (w, x, y, z).
      mass: kg.
      inertia: principal moments about the centre of mass, kg*m^2.
      ipos, iquat: centre of mass and principal axes in the body's frame, m and (w, x, y, z).
      gravcomp: fraction of the body's weight that is compensated.
      mocap: whether the body's pose is an input.
    """

    name: str
    parent: str | None
    mocap: bool
    geometries: tuple[GeometryDescriptor, ...]
    joints: tuple[JointDescriptor, ...]
    pos: tuple[float, ...] = _vector(3, "m")
    quat: tuple[float, ...] = _vector(4)
    mass: float = _number("kg")
    inertia: tuple[float, ...] = _vector(3, "kg*m^2")
    ipos: tuple[float, ...] = _vector(3, "m")
    iquat: tuple[float, ...] = _vector(4)
    gravcomp: float = _number()


@dataclasses.dataclass(frozen=True)
class FlexDescriptor:
    """One flexible object (cable, cloth, soft body).

    Attributes:
      dim: 1, 2 or 3.
      nvert, nelem: numbers of vertices and elements.
      radius: of the vertices, m.
      friction: sliding (1), torsional (m), rolling (m) coefficients.
      stiffness: edge stiffness.
      damping: edge damping.
    """

    name: str
    dim: int
    nvert: int
    nelem: int
    radius: float = _number("m")
    friction: tuple[float, ...] = _vector(3)
    stiffness: float = _number("N/m")
    damping: float = _number("N*s/m")


@dataclasses.dataclass(frozen=True)
class EntityDescriptor:
    """A kinematic tree, or the static surroundings, or a flexible object.

    Attributes:
      name: name of the root part.
      kind: `robot` if an actuator acts on the tree, else `rigid_object` (one free joint and no
        other), `articulated_object` (other joints), `deformable`, or `static` (welded to the
        world).
    """

    name: str
    kind: EntityKind
    parts: tuple[PartDescriptor, ...]
    flexes: tuple[FlexDescriptor, ...] = ()

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return sum(part.mass for part in self.parts)

    @property
    def joints(self) -> tuple[JointDescriptor, ...]:
        """All joints, in the order of the state vector."""
        return tuple(joint for part in self.parts for joint in part.joints)

    @property
    def geometries(self) -> tuple[GeometryDescriptor, ...]:
        """All geometries."""
        return tuple(geometry for part in self.parts for geometry in part.geometries)


@dataclasses.dataclass(frozen=True)
class ActuatorDescriptor:
    """One actuator.

    Attributes:
      transmission: joint, jointinparent, slidercrank, tendon, site or body.
      target: name of what it acts on.
      dynamics, gain, bias: MuJoCo's dyntype, gaintype and biastype.
      controls: how many entries of the control vector it reads (0 for a passive one).
      ctrllimited, forcelimited: whether the ranges are enforced.
      gear: scaling of length and force.
      gainprm, biasprm: first three parameters of gain and bias.
      dynprm: first parameter of the dynamics (time constant, s).
      ctrlrange, forcerange: limits of control and force; (0, 0) when unlimited.
    """

    name: str
    transmission: str
    target: str
    dynamics: str
    gain: str
    bias: str
    controls: int
    ctrllimited: bool
    forcelimited: bool
    gear: tuple[float, ...] = _vector(6)
    gainprm: tuple[float, ...] = _vector(3)
    biasprm: tuple[float, ...] = _vector(3)
    dynprm: float = _number("s")
    ctrlrange: tuple[float, ...] = _vector(2)
    forcerange: tuple[float, ...] = _vector(2, "N*m or N")


@dataclasses.dataclass(frozen=True)
class WorldDescriptor:
    """World configuration.

    Attributes:
      integrator, cone, solver: by MuJoCo's names, lower case.
      disabled: disabled engine features.
      timestep: s. gravity: m/s^2. wind: m/s. density: of the medium, kg/m^3.
      viscosity: of the medium, Pa*s. impratio: ratio of frictional to normal impedance.
    """

    integrator: str
    cone: str
    solver: str
    disabled: tuple[str, ...]
    timestep: float = _number("s")
    gravity: tuple[float, ...] = _vector(3, "m/s^2")
    wind: tuple[float, ...] = _vector(3, "m/s")
    magnetic: tuple[float, ...] = _vector(3)
    density: float = _number("kg/m^3")
    viscosity: float = _number("Pa*s")
    impratio: float = _number()


@dataclasses.dataclass(frozen=True)
class SceneDescriptor:
    """Everything static about a scene.

    Attributes:
      name: the model's name.
      entities: the static surroundings first, then the others in the order of the state vector.
      actuators: in the order of the control vector.
      world: world configuration.
      counts: what else the model holds (equality constraints, tendons, sensors, cameras ...).
    """

    name: str
    entities: tuple[EntityDescriptor, ...]
    actuators: tuple[ActuatorDescriptor, ...]
    world: WorldDescriptor
    counts: tuple[tuple[str, int], ...]

    def entity(self, name: str) -> EntityDescriptor:
        """The entity of that name.

        Raises:
          UnknownNameError: there is none.
        """
        for entity in self.entities:
            if entity.name == name:
                return entity
        raise UnknownNameError("entity", name, [e.name for e in self.entities])

    @functools.cached_property
    def joints(self) -> tuple[JointDescriptor, ...]:
        """All joints, in the order of the state vector."""
        return tuple(joint for entity in self.entities for joint in entity.joints)

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers, strings, lists and dictionaries (surfaces by their size only)."""
        plain: dict[str, Any] = _plain(self)
        plain["counts"] = dict(self.counts)
        return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Surface):
        return {"points": len(value.points), "area": value.area}
    if dataclasses.is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value


# ---------------------------------------------------------------------------------------------
# From a compiled model

MeshSurfaces = Callable[[int], Surface]
"""The surface of a mesh asset by its id."""


def describe(model: mujoco.MjModel, *, name: str = "scene") -> SceneDescriptor:
    """Describes a compiled model."""
    surfaces = functools.cache(functools.partial(sample_mesh_surface, model))
    return SceneDescriptor(
        name=name,
        entities=tuple(_entities(model, surfaces)),
        actuators=tuple(_actuator(model, i) for i in range(model.nactuator)),
        world=_world(model),
        counts=tuple(
            (label, int(getattr(model, field)))
            for label, field in (
                ("nq", "nq"),
                ("nv", "nv"),
                ("nu", "nu"),
                ("na", "na"),
                ("bodies", "nbody"),
                ("geoms", "ngeom"),
                ("equalities", "neq"),
                ("tendons", "ntendon"),
                ("sensors", "nsensor"),
                ("cameras", "ncam"),
                ("keyframes", "nkey"),
                ("plugins", "nplugin"),
            )
        ),
    )


def _entities(model: mujoco.MjModel, surfaces: MeshSurfaces) -> Iterator[EntityDescriptor]:
    by_entity: dict[int, list[int]] = {}
    for body in range(model.nbody):
        by_entity.setdefault(int(model.body_treeid[body]), []).append(body)
    flex_by_entity: dict[int, list[int]] = {}
    for flex in range(model.nflex):
        flex_by_entity.setdefault(_flex_tree(model, flex), []).append(flex)
    actuated = set(_actuated_trees(model))
    for tree, bodies in by_entity.items():
        flexes = tuple(_flex(model, flex) for flex in flex_by_entity.get(tree, ()))
        kind: EntityKind
        if tree < 0:
            kind = "static"
        elif flexes:
            kind = "deformable"
        elif tree in actuated:
            kind = "robot"
        else:
            kind = "rigid_object" if _moves_freely(model, bodies) else "articulated_object"
        parts = tuple(_part(model, body, surfaces) for body in bodies)
        yield EntityDescriptor(parts[0].name, kind, parts, flexes)


def _moves_freely(model: mujoco.MjModel, bodies: list[int]) -> bool:
    """Whether the tree is one rigid body on a free joint (and what is welded to it)."""
    joints = [int(model.body_jntadr[b]) for b in bodies if model.body_jntnum[b]]
    return len(joints) == 1 and model.jnt_type[joints[0]] == mujoco.mjtJoint.mjJNT_FREE


def _flex_tree(model: mujoco.MjModel, flex: int) -> int:
    start, count = int(model.flex_vertadr[flex]), int(model.flex_vertnum[flex])
    bodies = model.flex_vertbodyid[start : start + count]
    if model.flex_nodenum[flex]:
        start, count = int(model.flex_nodeadr[flex]), int(model.flex_nodenum[flex])
        bodies = model.flex_nodebodyid[start : start + count]
    trees = [int(model.body_treeid[body]) for body in bodies if body >= 0]
    return max(trees, default=-1)


def _actuated_trees(model: mujoco.MjModel) -> Iterator[int]:
    for actuator in range(model.nactuator):
        kind = mujoco.mjtTrn(model.actuator_trntype[actuator])
        target = int(model.actuator_trnid[actuator, 0])
        if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            bodies = [int(model.jnt_bodyid[target])]
        elif kind in (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK):
            bodies = [int(model.site_bodyid[target])]
        elif kind == mujoco.mjtTrn.mjTRN_BODY:
            bodies = [target]
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            bodies = list(_tendon_bodies(model, target))
        else:
            bodies = []
        yield from (int(model.body_treeid[body]) for body in bodies)


def _tendon_bodies(model: mujoco.MjModel, tendon: int) -> Iterator[int]:
    start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    for wrap in range(start, start + count):
        kind = mujoco.mjtWrap(model.wrap_type[wrap])
        target = int(model.wrap_objid[wrap])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            yield int(model.jnt_bodyid[target])
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            yield int(model.site_bodyid[target])


def name_of(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int, label: str) -> str:
    """The element's name, or its label and number where it has none."""
    return mujoco.mj_id2name(model, kind, index) or f"{label}{index}"


def _body_name(model: mujoco.MjModel, body: int) -> str:
    return name_of(model, mujoco.mjtObj.mjOBJ_BODY, body, "body")


def _part(model: mujoco.MjModel, body: int, surfaces: MeshSurfaces) -> PartDescriptor:
    geoms = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    return PartDescriptor(
        name=_body_name(model, body),
        parent=None if body == 0 else _body_name(model, int(model.body_parentid[body])),
        mocap=bool(model.body_mocapid[body] >= 0),
        geometries=tuple(_geometry(model, geom, surfaces) for geom in geoms),
        joints=tuple(_joint(model, joint) for joint in joints),
        pos=_floats(model.body_pos[body]),
        quat=_floats(model.body_quat[body]),
        mass=float(model.body_mass[body]),
        inertia=_floats(model.body_inertia[body]),
        ipos=_floats(model.body_ipos[body]),
        iquat=_floats(model.body_iquat[body]),
        gravcomp=float(model.body_gravcomp[body]),
    )


def _geometry(model: mujoco.MjModel, geom: int, surfaces: MeshSurfaces) -> GeometryDescriptor:
    kind = mujoco.mjtGeom(model.geom_type[geom])
    mesh = None
    surface = None
    mesh_id = int(model.geom_dataid[geom])
    if mesh_id >= 0 and kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF):
        mesh = name_of(model, mujoco.mjtObj.mjOBJ_MESH, mesh_id, "mesh")
        surface = surfaces(mesh_id)
    elif kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        surface = sample_geom_surface(model, geom)
    return GeometryDescriptor(
        name=name_of(model, mujoco.mjtObj.mjOBJ_GEOM, geom, "geom"),
        type=_enum_name(kind),
        size=_floats(model.geom_size[geom]),
        pos=_floats(model.geom_pos[geom]),
        quat=_floats(model.geom_quat[geom]),
        friction=_floats(model.geom_friction[geom]),
        solref=_floats(model.geom_solref[geom]),
        solimp=_floats(model.geom_solimp[geom]),
        margin=float(model.geom_margin[geom]),
        gap=float(model.geom_gap[geom]),
        rgba=_floats(model.geom_rgba[geom]),
        condim=int(model.geom_condim[geom]),
        contype=int(model.geom_contype[geom]),
        conaffinity=int(model.geom_conaffinity[geom]),
        mesh=mesh,
        surface=surface,
    )


def _joint(model: mujoco.MjModel, joint: int) -> JointDescriptor:
    body = int(model.jnt_bodyid[joint])
    dof = int(model.jnt_dofadr[joint])
    adr = int(model.jnt_qposadr[joint])
    kind = mujoco.mjtJoint(model.jnt_type[joint])
    scalar = kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    return JointDescriptor(
        name=name_of(model, mujoco.mjtObj.mjOBJ_JOINT, joint, "joint"),
        type=_enum_name(kind),
        parent=_body_name(model, int(model.body_parentid[body])),
        child=_body_name(model, body),
        limited=bool(model.jnt_limited[joint]),
        axis=_floats(model.jnt_axis[joint]),
        pos=_floats(model.jnt_pos[joint]),
        range=_floats(model.jnt_range[joint]),
        ref=float(model.qpos0[adr]) if scalar else 0.0,
        springref=float(model.qpos_spring[adr]) if scalar else 0.0,
        stiffness=(float(model.jnt_stiffness[joint]), *_floats(model.jnt_stiffnesspoly[joint])),
        damping=(float(model.dof_damping[dof]), *_floats(model.dof_dampingpoly[dof])),
        frictionloss=float(model.dof_frictionloss[dof]),
        armature=float(model.dof_armature[dof]),
    )


def _flex(model: mujoco.MjModel, flex: int) -> FlexDescriptor:
    return FlexDescriptor(
        name=name_of(model, mujoco.mjtObj.mjOBJ_FLEX, flex, "flex"),
        dim=int(model.flex_dim[flex]),
        nvert=int(model.flex_vertnum[flex]),
        nelem=int(model.flex_elemnum[flex]),
        radius=float(model.flex_radius[flex]),
        friction=_floats(model.flex_friction[flex]),
        stiffness=float(model.flex_edgestiffness[flex]),
        damping=float(model.flex_edgedamping[flex]),
    )


_TRANSMISSION_OBJECT = {
    mujoco.mjtTrn.mjTRN_JOINT: mujoco.mjtObj.mjOBJ_JOINT,
    mujoco.mjtTrn.mjTRN_JOINTINPARENT: mujoco.mjtObj.mjOBJ_JOINT,
    mujoco.mjtTrn.mjTRN_TENDON: mujoco.mjtObj.mjOBJ_TENDON,
    mujoco.mjtTrn.mjTRN_SITE: mujoco.mjtObj.mjOBJ_SITE,
    mujoco.mjtTrn.mjTRN_SLIDERCRANK: mujoco.mjtObj.mjOBJ_SITE,
    mujoco.mjtTrn.mjTRN_BODY: mujoco.mjtObj.mjOBJ_BODY,
}


def _actuator(model: mujoco.MjModel, index: int) -> ActuatorDescriptor:
    transmission = mujoco.mjtTrn(model.actuator_trntype[index])
    target = int(model.actuator_trnid[index, 0])
    kind = _TRANSMISSION_OBJECT.get(transmission)
    label = _enum_name(transmission)
    controls = int(model.actuator_ctrlnum[index])
    control, output = int(model.actuator_ctrladr[index]), int(model.actuator_outadr[index])
    return ActuatorDescriptor(
        name=name_of(model, mujoco.mjtObj.mjOBJ_ACTUATOR, index, "actuator"),
        transmission=label,
        target=name_of(model, kind, target, label) if kind is not None else "",
        dynamics=_enum_name(mujoco.mjtDyn(model.actuator_dyntype[index])),
        gain=_enum_name(mujoco.mjtGain(model.actuator_gaintype[index])),
        bias=_enum_name(mujoco.mjtBias(model.actuator_biastype[index])),
        controls=controls,
        ctrllimited=bool(controls and model.actuator_ctrllimited[control]),
        forcelimited=bool(model.actuator_forcelimited[index]),
        gear=_floats(model.actuator_gear[output]),
        gainprm=_floats(model.actuator_gainprm[index, :3]),
        biasprm=_floats(model.actuator_biasprm[index, :3]),
        dynprm=float(model.actuator_dynprm[index, 0]),
        ctrlrange=_floats(model.actuator_ctrlrange[control]) if controls else (0.0, 0.0),
        forcerange=_floats(model.actuator_forcerange[index]),
    )


def _world(model: mujoco.MjModel) -> WorldDescriptor:
    option = model.opt
    return WorldDescriptor(
        integrator=_enum_name(mujoco.mjtIntegrator(option.integrator)),
        cone=_enum_name(mujoco.mjtCone(option.cone)),
        solver=_enum_name(mujoco.mjtSolver(option.solver)),
        disabled=tuple(
            _enum_name(bit)
            for bit in mujoco.mjtDisableBit.__members__.values()
            if _is_flag(bit) and option.disableflags & int(bit)
        ),
        timestep=float(option.timestep),
        gravity=_floats(option.gravity),
        wind=_floats(option.wind),
        magnetic=_floats(option.magnetic),
        density=float(option.density),
        viscosity=float(option.viscosity),
        impratio=float(option.impratio),
    )


def _is_flag(bit: Any) -> bool:
    return str(bit.name).startswith("mjDSBL_")


def _enum_name(member: Any) -> str:
    """`mjGEOM_BOX` -> `box`."""
    return str(member.name).split("_", 1)[1].lower()


def _floats(values: npt.NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(float(value) for value in np.ravel(values))
