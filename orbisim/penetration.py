"""How deep bodies stand in each other along state sequences.

Pairs of bodies are grouped by what their entities are (`EntityDescriptor.kind`):

| part of a group's name | kind of entity |
| --- | --- |
| `robot` | a tree that an actuator acts on |
| `object` | a rigid or articulated object |
| `deformable` | a flexible object |
| `world` | the static surroundings |

`object-object` is two cubes, `object-world` a cube on a table, `robot-robot` a hand and its arm.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.scene import Scene
from orbisim.scene.descriptor import name_of

Floats = npt.NDArray[np.float64]

PARTS = ("robot", "object", "deformable", "world")
"""Of a group's name, in this order."""
_PART_OF = {
    "robot": "robot",
    "rigid_object": "object",
    "articulated_object": "object",
    "deformable": "deformable",
    "static": "world",
}


class Deepest(NamedTuple):
    """The deepest penetration of a group.

    Attributes:
      depth: m. world, step: where; indices of `Penetration.depth`.
      between: names of the two bodies (or flexible objects); of the world, of its geoms.
    """

    depth: float
    world: int
    step: int
    between: tuple[str, str]


@dataclasses.dataclass(frozen=True)
class Penetration:
    """Penetration along state sequences.

    Attributes:
      depth: for each group whose bodies can touch [nworld, T] the deepest penetration, m: the
        overlap along the normal of a contact, as C MuJoCo's collision detection measures it; 0
        where nothing overlaps, NaN where a state is not finite.
      deepest: for each of them where it is deepest; None if nothing overlaps.
    """

    depth: Mapping[str, Floats]
    deepest: Mapping[str, Deepest | None]


def penetration(scene: Scene, qpos: Floats) -> Penetration:
    """Measures the penetration of states.

    Args:
      scene: whose. qpos: [nworld, T, nq].
    """
    model, kinds = scene.model, _Kinds(scene)
    names = groups(scene)
    depth = {name: np.zeros(qpos.shape[:2]) for name in names}
    deepest: dict[str, Deepest | None] = dict.fromkeys(names)
    data = mujoco.MjData(model)
    for world, step in np.ndindex(*qpos.shape[:2]) if names else ():
        if not np.isfinite(qpos[world, step]).all():
            for rows in depth.values():
                rows[world, step] = np.nan
            continue
        data.qpos[:] = qpos[world, step]
        for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_flex, mujoco.mj_collision):
            stage(model, data)
        overlaps = -data.contact.dist
        for number in map(int, np.flatnonzero(overlaps > 0.0)):
            one, other = (kinds.element(data.contact, number, side) for side in (0, 1))
            name, found = group_of(kinds.part(one), kinds.part(other)), float(overlaps[number])
            before = deepest[name]
            depth[name][world, step] = max(float(depth[name][world, step]), found)
            if before is None or found > before.depth:
                between = [kinds.called(data.contact, number, side) for side in (0, 1)]
                deepest[name] = Deepest(found, world, step, (between[0], between[1]))
    return Penetration(depth, deepest)


def groups(scene: Scene) -> tuple[str, ...]:
    """Names of the groups whose bodies the scene lets touch.

    By MuJoCo's rules: bit masks, `<exclude>`, bodies welded together, parents and children, and
    `<pair>`, which overrules all of them.
    """
    model, kinds = scene.model, _Kinds(scene)
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return ()
    found = {
        group_of(kinds.part(one.element), kinds.part(other.element))
        for one, other in itertools.combinations(_colliding(model), 2)
        if _may_touch(model, one, other)
    }
    for pair in range(model.npair):
        bodies = (
            model.geom_bodyid[model.pair_geom1[pair]],
            model.geom_bodyid[model.pair_geom2[pair]],
        )
        found.add(group_of(*(kinds.part(_Element(False, int(body))) for body in bodies)))
    if np.any(model.flex_selfcollide != int(mujoco.mjtFlexSelf.mjFLEXSELF_NONE)):
        found.add(group_of("deformable", "deformable"))
    return tuple(name for name in _all_groups() if name in found)


def group_of(one: str, other: str) -> str:
    """The name of the group of two parts of `PARTS`, in either order."""
    return "-".join(sorted((one, other), key=PARTS.index))


def _all_groups() -> Iterable[str]:
    return itertools.starmap(group_of, itertools.combinations_with_replacement(PARTS, 2))


class _Element(NamedTuple):
    """A body, or a flexible object."""

    flexible: bool
    number: int


class _Collider(NamedTuple):
    """Geoms of one body (or a flexible object) with the same bit masks."""

    element: _Element
    contype: int
    conaffinity: int


class _Kinds:
    """Which part of a group's name an element of a contact is, and what it is called."""

    def __init__(self, scene: Scene) -> None:
        self.model = scene.model
        names = {
            part.name: _PART_OF[entity.kind]
            for entity in scene.descriptor.entities
            for part in entity.parts
        }
        self._bodies = [names[self.name(_Element(False, b))] for b in range(self.model.nbody)]

    def part(self, element: _Element) -> str:
        """One of `PARTS`."""
        return "deformable" if element.flexible else self._bodies[element.number]

    def name(self, element: _Element) -> str:
        """As descriptors have it."""
        if element.flexible:
            return name_of(self.model, mujoco.mjtObj.mjOBJ_FLEX, element.number, "flex")
        return name_of(self.model, mujoco.mjtObj.mjOBJ_BODY, element.number, "body")

    def called(self, contacts: Any, number: int, side: int) -> str:
        """The name of one of the two sides of a contact, for people."""
        element, geom = self.element(contacts, number, side), int(contacts.geom[number, side])
        if self.part(element) == "world" and self.model.geom(geom).name:
            return str(self.model.geom(geom).name)  # a table, a floor
        return self.name(element)

    def element(self, contacts: Any, number: int, side: int) -> _Element:
        """One of the two sides of a contact."""
        geom = int(contacts.geom[number, side])
        if geom >= 0:
            return _Element(False, int(self.model.geom_bodyid[geom]))
        return _Element(True, int(contacts.flex[number, side]))


def _colliding(model: mujoco.MjModel) -> list[_Collider]:
    bodies = {
        _Collider(_Element(False, int(body)), int(one), int(other))
        for body, one, other in zip(
            model.geom_bodyid, model.geom_contype, model.geom_conaffinity, strict=True
        )
    }
    flexes = (
        _Collider(_Element(True, i), int(model.flex_contype[i]), int(model.flex_conaffinity[i]))
        for i in range(model.nflex)
    )
    return [c for c in (*sorted(bodies), *flexes) if c.contype or c.conaffinity]


def _may_touch(model: mujoco.MjModel, one: _Collider, other: _Collider) -> bool:
    if not (one.contype & other.conaffinity or other.contype & one.conaffinity):
        return False
    if one.element.flexible or other.element.flexible:
        return True
    bodies = (one.element.number, other.element.number)
    low, high = sorted(bodies)
    if ((low << 16) + high) in model.exclude_signature:
        return False
    welds = [int(model.body_weldid[body]) for body in bodies]
    if welds[0] == welds[1]:
        return False
    parents = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
    related = (welds[0] == parents[1] and welds[0] != 0) or (
        welds[1] == parents[0] and welds[1] != 0
    )
    return not related or bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
