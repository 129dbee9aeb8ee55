"""A dumped stage as an `MjSpec`."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from orbisim.scene.reading import ReadResult
from orbisim.scene.usd.actuators import ActuatorBuilder
from orbisim.scene.usd.assets import MaterialAssets, MeshAssets
from orbisim.scene.usd.bodies import Bodies
from orbisim.scene.usd.carried import add_carried
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.equalities import add_equalities, close_loop
from orbisim.scene.usd.filters import FilterReader
from orbisim.scene.usd.geom_elements import GeomBuilder, add_site
from orbisim.scene.usd.geoms import Geometry, is_site, read_geometry
from orbisim.scene.usd.inertials import InertiaBuilder
from orbisim.scene.usd.joint_elements import JointBuilder
from orbisim.scene.usd.joints import Joint, read_joints
from orbisim.scene.usd.names import NameBook, unique_names
from orbisim.scene.usd.options import prefer_implicit, set_options
from orbisim.scene.usd.physx_tendons import add_physx_tendons
from orbisim.scene.usd.registry import Registry
from orbisim.scene.usd.report import report
from orbisim.scene.usd.scenery import add_scenery
from orbisim.scene.usd.shapes import shapes_of
from orbisim.scene.usd.start import add_native_keys, add_start
from orbisim.scene.usd.tendons import add_distance, add_tendons
from orbisim.scene.usd.tree import Forest, grow


def build(context: Context) -> ReadResult:
    """The whole stage as a spec.

    Raises:
      SceneError: the stage holds no physics, or something in it is wrong.
    """
    bodies = Bodies(context)
    geometry = read_geometry(context, bodies)
    if not bodies.all and not any(item.collides for item in geometry):
        raise context.error(
            "holds no physics: no prim has PhysicsRigidBodyAPI or is a collider that OrbiSim "
            "can read" + _what_instead(context)
        )
    joints = read_joints(context, bodies)
    forest = grow(context, bodies, joints)
    builder = _SpecBuilder(context, bodies, geometry, joints, forest)
    spec = builder.build()
    report(context)
    return ReadResult(spec, context.unsupported, context.warnings)


def _what_instead(context: Context) -> str:
    """Names what a stage without rigid bodies does hold, if it is physics of another kind."""
    kinds = {
        prim.flat.type_name
        for prim in context.of_type("TetMesh", "Points", "BasisCurves", "PointInstancer")
    }
    if any("deformable" in entry.feature for entry in context.unsupported):
        kinds.add("deformable bodies")
    return f" (it holds {', '.join(sorted(kinds))})" if kinds else ""


class _SpecBuilder:
    """Puts the parts together, in MuJoCo's order of dependence."""

    def __init__(
        self,
        context: Context,
        bodies: Bodies,
        geometry: Sequence[Geometry],
        joints: Sequence[Joint],
        forest: Forest,
    ) -> None:
        self._context, self._bodies = context, bodies
        self._joints, self._forest = joints, forest
        self._spec = mujoco.MjSpec()
        self._registry = Registry(self._spec)
        self._by_body: dict[str, list[Geometry]] = {}
        for item in geometry:
            self._by_body.setdefault(item.body, []).append(item)
        self._filters = FilterReader(context, bodies, geometry).read(joints)
        self._meshes = MeshAssets(self._spec)
        self._geoms = GeomBuilder(
            context,
            self._meshes,
            MaterialAssets(context, self._spec),
            unique_names(item.prim.flat for item in geometry),
            self._filters.masks,
        )
        self._static = _static_bodies(forest)

    def build(self) -> mujoco.MjSpec:
        set_options(self._context, self._spec)
        self._add_bodies()
        self._add_sites()
        add_scenery(self._context, self._registry, self._bodies)
        add_tendons(self._context, self._registry)
        add_physx_tendons(self._context, self._registry)
        self._add_constraints()
        actuators = ActuatorBuilder(self._context, self._registry, self._forest)
        actuators.add_all()
        if actuators.driven:
            prefer_implicit(self._context, self._spec)
        self._exclude()
        add_carried(self._context, self._spec)
        add_native_keys(self._context, self._spec)
        add_start(self._context, self._registry, self._bodies, self._forest, actuators)
        return self._spec

    def _add_bodies(self) -> None:
        names = unique_names((b.prim.flat for b in self._bodies.all.values()), ("world",))
        joint_names = unique_names(joint.prim.flat for joint in self._joints)
        joints = JointBuilder(self._context, self._registry, joint_names)
        inertias = InertiaBuilder(self._context, self._spec, self._forest, self._by_body)
        self._add_geoms("", self._spec.worldbody, static=True)
        for link in self._forest.links:
            path = link.body.path
            child = self._registry.body(link.parent).add_body(name=names[path])
            child.pos, child.quat = link.pose.pos, link.pose.quat
            child.mocap, child.gravcomp = link.mocap, link.body.gravcomp
            self._registry.bodies[path] = names[path]
            joints.add(child, link)
            self._add_geoms(path, child, static=path in self._static)
            inertias.set(child, link)

    def _add_geoms(self, path: str, parent: mujoco.MjsBody, *, static: bool) -> None:
        for item in self._by_body.get(path, ()):
            self._registry.geoms[item.path] = self._geoms.add(parent, item, static=static)

    def _add_sites(self) -> None:
        prims = [prim for prim in self._context.prims.values() if is_site(prim)]
        names = unique_names(prim.flat for prim in prims)
        self._registry.site_names = NameBook(names.values())
        for prim in prims:
            owner = self._bodies.owner(prim.path)
            pose = self._bodies.pose_in(prim.path, owner)
            parent = self._registry.body(owner.path if owner else None)
            shapes = shapes_of(self._context, prim) or []
            add_site(self._context, parent, prim, shapes, pose, names[prim.path])
            self._registry.sites[prim.path] = names[prim.path]

    def _add_constraints(self) -> None:
        add_equalities(self._context, self._registry, self._bodies)
        for joint in self._joints:
            if joint.distance is not None:
                add_distance(self._context, self._registry, joint)
        for joint in self._forest.loops:
            close_loop(self._context, self._registry, joint)

    def _exclude(self) -> None:
        """Filtered pairs of bodies, less those that MuJoCo filters itself.

        MuJoCo filters parent and child unless the parent is fixed to the world. A stage that
        was made for MuJoCo keeps all its pairs.
        """
        if self._filters.parents_collide:
            self._spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
        own = {
            frozenset((link.parent, link.body.path))
            for link in self._forest.links
            if link.parent is not None and link.parent not in self._static
        }
        keep_all = self._filters.parents_collide or self._context.for_mujoco
        for pair in self._filters.pairs:
            if keep_all or pair not in own:
                first, second = (self._registry.bodies[path] for path in sorted(pair))
                self._spec.add_exclude(bodyname1=first, bodyname2=second)


def _static_bodies(forest: Forest) -> frozenset[str]:
    """Bodies that are fixed to the world, directly or through others."""
    static: set[str] = set()
    for link in forest.links:
        held = link.parent is None or link.parent in static
        if held and not (link.chain or link.floats or link.mocap):
            static.add(link.body.path)
    return frozenset(static)
