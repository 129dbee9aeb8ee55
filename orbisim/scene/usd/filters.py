"""Which colliders do not collide, in MuJoCo's terms: body pairs and bit masks."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.bodies import Bodies
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import is_within
from orbisim.scene.usd.geoms import Geometry
from orbisim.scene.usd.joints import Joint
from orbisim.scene.usd.tree import articulation_of

_BITS = 31
"""Of MuJoCo's contype and conaffinity that can be used: they are signed 32-bit numbers."""
_MAX_PAIRS = 200_000
"""Filtered pairs of bodies: a file of a megabyte can name billions."""
BodyPair = frozenset[str]


@dataclasses.dataclass(frozen=True)
class Masks:
    """A geom's collision bit masks."""

    contype: int
    conaffinity: int


@dataclasses.dataclass(frozen=True)
class Filters:
    """What does not collide.

    Attributes:
      pairs: pairs of body paths ("" for the world).
      masks: by path, for colliders whose masks are not MuJoCo's default.
      parents_collide: whether a joint asks that the bodies it joins collide.
    """

    pairs: tuple[BodyPair, ...]
    masks: Mapping[str, Masks]
    parents_collide: bool


class FilterReader:
    """Collects filters from all places where UsdPhysics has them."""

    def __init__(self, context: Context, bodies: Bodies, geometry: Sequence[Geometry]) -> None:
        self._context = context
        self._bodies = bodies
        self._colliders = {item.path: item for item in geometry if item.collides}
        self._members: dict[str, list[str]] = defaultdict(list)
        for path, item in self._colliders.items():
            self._members[item.body].append(path)
        self._pairs: dict[BodyPair, None] = {}
        self._apart: dict[str, set[str]] = defaultdict(set)

    def read(self, joints: Sequence[Joint]) -> Filters:
        """All filters.

        Raises:
          SceneError: a filter leads to a prim that does not exist, or there are too many pairs.
        """
        self._read_pairs()
        self._read_groups()
        self._read_articulations()
        parents_collide = self._read_joints(joints)
        if len(self._pairs) > _MAX_PAIRS:
            raise self._context.error(
                f"{len(self._pairs)} pairs of bodies are filtered; at most {_MAX_PAIRS} can be"
            )
        return Filters(tuple(self._pairs), self._masks(), parents_collide)

    def _read_pairs(self) -> None:
        for prim in self._context.with_schema("PhysicsFilteredPairsAPI"):
            for target in prim.targets("physics:filteredPairs"):
                if target not in self._context.prims:
                    raise prim.error(
                        f"physics:filteredPairs leads to <{target}>, which does not exist"
                    )
                self._separate(self._resolve(prim.path), self._resolve(target))

    def _resolve(self, path: str) -> tuple[list[str], list[str]]:
        """The bodies, or the colliders, that a prim of a filtered pair stands for."""
        if path in self._bodies.all:
            return [path], []
        if path in self._colliders:
            return self._as_bodies([path])
        bodies = [body for body in self._bodies.all if is_within(body, path)]
        if bodies:
            return bodies, []
        return self._as_bodies([p for p in self._colliders if is_within(p, path)])

    def _as_bodies(self, colliders: Sequence[str]) -> tuple[list[str], list[str]]:
        """Colliders, or their body if they are all that it has."""
        owners = {self._colliders[path].body for path in colliders}
        if len(owners) == 1 and "" not in owners:
            (owner,) = owners
            if set(self._members[owner]) <= set(colliders):
                return [owner], []
        return [], list(colliders)

    def _separate(
        self, one: tuple[list[str], list[str]], other: tuple[list[str], list[str]]
    ) -> None:
        (bodies1, colliders1), (bodies2, colliders2) = one, other
        if not colliders1 and not colliders2:
            self._separate_bodies((a, b) for a in bodies1 for b in bodies2)
            return
        first = [*colliders1, *(p for body in bodies1 for p in self._members[body])]
        second = [*colliders2, *(p for body in bodies2 for p in self._members[body])]
        for a in first:
            for b in second:
                if self._colliders[a].body != self._colliders[b].body:
                    self._apart[a].add(b)
                    self._apart[b].add(a)

    def _separate_bodies(self, pairs: Iterable[tuple[str, str]]) -> None:
        for a, b in pairs:
            if a != b:
                self._pairs.setdefault(frozenset((a, b)))
            if len(self._pairs) > _MAX_PAIRS:
                return

    def _read_groups(self) -> None:
        """Collision groups; groups with the same merge group count as one."""
        groups = list(self._context.of_type("PhysicsCollisionGroup"))
        merged = {prim.path: prim.token("physics:mergeGroup", "") or prim.path for prim in groups}
        members: dict[str, set[str]] = defaultdict(set)
        for prim in groups:
            inside = set(prim.targets("colliders")) & set(self._colliders)
            members[merged[prim.path]] |= inside
        for prim in groups:
            named = {merged[path] for path in prim.targets("physics:filteredGroups")
                     if path in merged}  # fmt: skip
            own = members[merged[prim.path]]
            if prim.flag("physics:invertFilteredGroups", False):
                spared = set().union(*(members[name] for name in named))
                others = set(self._colliders) - spared
            else:
                others = set().union(*(members[name] for name in named))
            for path in own:
                self._apart[path] |= others
            for path in others:
                self._apart[path] |= own

    def _read_articulations(self) -> None:
        """Articulations whose bodies do not collide with each other."""
        together: dict[str, list[str]] = defaultdict(list)
        for path in self._bodies.all:
            root = articulation_of(self._context, path)
            if root is not None:
                together[root].append(path)
        for prim in self._context.with_schema("PhysicsArticulationRootAPI"):
            newton = prim.flag("newton:selfCollisionEnabled", True)
            physx = prim.flag("physxArticulation:enabledSelfCollisions", True)
            if not (newton and physx):
                self._separate_bodies(combinations(together[prim.path], 2))

    def _read_joints(self, joints: Sequence[Joint]) -> bool:
        """Joined bodies do not collide unless the joint says so.

        MuJoCo itself filters parent and child, except where the parent is fixed to the world;
        a stage that was made for MuJoCo leaves it at that.
        """
        asks = [joint for joint in joints if _collides(joint.prim)]
        if self._context.for_mujoco:
            return bool(asks)
        for joint in joints:
            if joint in asks:
                continue
            if joint.body0 is not None and joint.body1 is not None:
                self._separate_bodies([(joint.body0, joint.body1)])
            else:
                self._separate_from_scenery(joint)
        return bool(asks)

    def _separate_from_scenery(self, joint: Joint) -> None:
        """A body joined to a prim that does not move does not collide with what is in it."""
        side = 1 if joint.body0 is not None else 0
        body = joint.body0 or joint.body1 or ""
        for target in joint.prim.targets(f"physics:body{side}"):
            if is_within(body, target):
                continue
            scenery = [p for p in self._members[""] if is_within(p, target)]
            if scenery:
                self._separate(([body], []), ([], scenery))

    def _masks(self) -> dict[str, Masks]:
        """One bit for each class of colliders that are filtered alike; the first for the rest."""
        apart = {path: frozenset(others) for path, others in self._apart.items() if others}
        classes: dict[frozenset[str], list[str]] = defaultdict(list)
        for path, others in apart.items():
            classes[others].append(path)
        if not classes:
            return {}
        if len(classes) > _BITS:
            self._context.omit(
                "PhysicsCollisionGroup, PhysicsFilteredPairsAPI",
                f"{len(classes)} classes of colliders that are filtered differently",
                f"only the first {_BITS} are told apart; the others collide with everything",
            )
        bits = {others: i + 1 for i, others in enumerate(list(classes)[:_BITS])}
        sample = {others: paths[0] for others, paths in classes.items() if others in bits}
        masks = {}
        for path in self._colliders:
            others = apart.get(path, frozenset())
            affinity = 1
            for other, bit in bits.items():
                if sample[other] not in others:
                    affinity |= 1 << bit
            masks[path] = Masks(1 << bits.get(others, 0), affinity)
        return masks


def _collides(prim: Prim) -> bool:
    return prim.flag("physics:collisionEnabled", False)
