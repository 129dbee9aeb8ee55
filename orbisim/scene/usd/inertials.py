"""Mass properties of the bodies of a spec."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from orbisim.scene.usd.assets import MaterialAssets, MeshAssets
from orbisim.scene.usd.bodies import Body
from orbisim.scene.usd.compiling import compiled
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FloatArray
from orbisim.scene.usd.geom_elements import GeomBuilder
from orbisim.scene.usd.geoms import Geometry
from orbisim.scene.usd.mass import (
    Inertial,
    MassApi,
    inertial_of,
    overridden,
    read_mass,
    total,
)
from orbisim.scene.usd.options import takes_inertia_from_geoms
from orbisim.scene.usd.tree import Forest, Link


class InertiaBuilder:
    """Sets mass properties, or leaves them to MuJoCo's compiler where geoms carry them."""

    def __init__(
        self,
        context: Context,
        spec: mujoco.MjSpec,
        forest: Forest,
        by_body: Mapping[str, Sequence[Geometry]],
    ) -> None:
        self._context, self._spec = context, spec
        self._forest, self._by_body = forest, by_body
        self._bodies = {link.body.path: link.body for link in forest.links}
        self._from_geoms = takes_inertia_from_geoms(context)

    def set(self, child: mujoco.MjsBody, link: Link) -> None:
        """Sets a body's mass properties unless its geoms say the same."""
        geometry = self._by_body.get(link.body.path, [])
        colliders = [item for item in geometry if item.collides]
        says = read_mass(self._context, link.body.prim)
        explicit = says.mass is not None or says.shapes_inertia
        if self._from_geoms and colliders == geometry and colliders:
            if explicit:
                self._context.warn(
                    "mjc:compiler:inertiaFromGeom is 'true': what the body says is overridden",
                    link.body.path,
                )
            return
        heavy = any(item.mass.mass != 0 for item in colliders)
        if heavy and not explicit and not any(item.mass.shapes_inertia for item in colliders):
            return
        massless = says.mass == 0 or not (heavy or explicit)
        if massless and self._may_be_massless(link):
            return
        if self._context.for_mujoco and not (link.chain or link.floats):
            says = _without_inertia(says)
        inertial = self._inertial(link.body, says, colliders)
        child.explicitinertial = True
        child.mass = inertial.mass
        child.ipos = inertial.com
        if says.principal is not None:
            child.inertia, child.iquat = says.principal
        elif inertial.inertia.any():
            child.fullinertia = inertial.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]

    def _may_be_massless(self, link: Link) -> bool:
        """Whether MuJoCo, for which the stage was made, takes a body without mass.

        It does if the body does not move by itself, or carries one that has mass.
        """
        if not self._context.for_mujoco:
            return False
        if not (link.chain or link.floats):
            return True
        carried = {link.body.path}
        for other in self._forest.links:
            if other.parent in carried and not (other.chain or other.floats or other.mocap):
                carried.add(other.body.path)
        return any(self._has_mass(path) for path in carried)

    def _has_mass(self, path: str) -> bool:
        says = read_mass(self._context, self._bodies[path].prim)
        colliders = (item for item in self._by_body.get(path, ()) if item.collides)
        return bool(says.mass) or any(item.mass.mass != 0 for item in colliders)

    def _inertial(self, body: Body, says: MassApi, colliders: Sequence[Geometry]) -> Inertial:
        complete = says.mass is not None and says.com is not None and says.inertia is not None
        computed = None if complete else total(self._parts(colliders))
        if computed is None and not (says.mass is not None and says.inertia is not None):
            self._context.warn(
                "no collider to compute its mass properties from; what is not given is that of "
                "a sphere of 0.1 m radius and one unit of mass",
                body.path,
            )
        return overridden(computed, says, self._context.units.mass)

    def _parts(self, colliders: Sequence[Geometry]) -> list[Inertial]:
        """What each collider contributes, in the body's frame."""
        parts = []
        for item in colliders:
            plain = self._compiled(item)
            if plain is None and item.mass.inertia is None:
                continue
            own = MassApi(mass=item.mass.mass, com=_in_body(item), inertia=_turned(item))
            parts.append(overridden(plain, own, self._context.units.mass))
        return parts

    def _compiled(self, item: Geometry) -> Inertial | None:
        """A collider's mass properties in the body's frame, by MuJoCo's compiler."""
        spec = mujoco.MjSpec()
        spec.compiler.inertiagrouprange = self._spec.compiler.inertiagrouprange
        builder = GeomBuilder(
            self._context, MeshAssets(spec), MaterialAssets(self._context, spec),
            {item.path: "geom"}, {},
        )  # fmt: skip
        builder.add(spec.worldbody.add_body(), item, static=False)
        return inertial_of(compiled(spec, self._context.source))


def _without_inertia(says: MassApi) -> MassApi:
    """For MuJoCo a body that does not move by itself may have mass and no inertia."""
    if not says.mass or says.com is None or says.inertia is not None:
        return says
    return dataclasses.replace(says, inertia=np.zeros((3, 3)))


def _in_body(item: Geometry) -> FloatArray | None:
    return None if item.mass.com is None else item.pose.apply(item.mass.com)


def _turned(item: Geometry) -> FloatArray | None:
    if item.mass.inertia is None:
        return None
    rotation = item.pose.rotation
    return np.asarray(rotation @ item.mass.inertia @ rotation.T)
