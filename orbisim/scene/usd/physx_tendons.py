"""PhysX's tendons as MuJoCo's, where both mean the same.

A fixed tendon has the length L = sum g_i q_i + offset over joints and a spring-damper on it; PhysX
applies the force to each joint times a force coefficient c_i, MuJoCo times g_i (virtual work). They
agree where c_i is a common multiple of g_i; what is not so is left out. A spatial tendon measures
lengths between attachments, from a root to each leaf.

Springs: MuJoCo has no force where the length is within `springlength`, so that PhysX's springs at
the limits are a spring of their own with the limits as its dead band.

Source: the documentation of PhysxTendonAxisRootAPI and PhysxTendonAttachmentRootAPI (Omniverse USD
Physics schema, 106), and of tendons in MuJoCo's XML reference.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import mujoco
import numpy as np

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.pose import Pose
from orbisim.scene.usd.registry import Registry
from orbisim.scene.usd.sites import add_marker
from orbisim.scene.usd.units import DEGREE

AXIS_ROOT, AXIS = "PhysxTendonAxisRootAPI", "PhysxTendonAxisAPI"
ATTACHMENT_ROOT = "PhysxTendonAttachmentRootAPI"
ATTACHMENT, LEAF = "PhysxTendonAttachmentAPI", "PhysxTendonAttachmentLeafAPI"
SCHEMAS = (AXIS_ROOT, AXIS, ATTACHMENT_ROOT, ATTACHMENT, LEAF)

_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
_ALIKE = 1e-4
"""Relative difference of ratios below which coefficients are float32 roundings of each other."""


def add_physx_tendons(context: Context, registry: Registry) -> None:
    """Adds the fixed and spatial tendons of PhysX, and lists those that MuJoCo cannot have."""
    for prim, name in _instances(context, AXIS_ROOT):
        _add_fixed(context, registry, prim, name)
    leaves = list(_instances(context, LEAF))
    for prim, name in leaves:
        _add_spatial(context, registry, prim, name)
    _take_note_of_the_rest(context)


def _instances(context: Context, schema: str) -> Iterator[tuple[Prim, str]]:
    """Prims with a multiple-apply schema, and its instance's name."""
    for prim in context.prims.values():
        for applied in prim.flat.schemas:
            kind, _, name = applied.partition(":")
            if kind == schema and name:
                yield prim, name


def _take_note_of_the_rest(context: Context) -> None:
    """Attributes of tendons were read, or their tendon is listed."""
    for prim in context.prims.values():
        if any(schema.partition(":")[0] in SCHEMAS for schema in prim.flat.schemas):
            names = (*prim.flat.attributes, *prim.flat.relationships)
            prim.use(*(name for name in names if name.startswith("physxTendon:")))


@dataclasses.dataclass(frozen=True)
class _Springs:
    """What acts on a length; SI, without the offset, which is taken off the others.

    Attributes:
      rest: where the spring is at rest; None for the length at the start.
    """

    stiffness: float
    damping: float
    limit_stiffness: float
    rest: float | None
    lower: float
    upper: float

    def scaled(self, factor: float, stretch: float = 1.0) -> _Springs:
        """Forces times `factor`; lengths divided by `stretch`, stiffness times it."""
        return dataclasses.replace(
            self,
            stiffness=self.stiffness * factor * stretch,
            damping=self.damping * factor,
            limit_stiffness=self.limit_stiffness * factor * stretch,
            rest=None if self.rest is None else self.rest / stretch,
            lower=self.lower / stretch,
            upper=self.upper / stretch,
        )


def _springs(context: Context, root: Prim, stem: str, leaf: Prim, leaf_stem: str) -> _Springs:
    """Springs with the root's stiffness and the leaf's lengths (of fixed tendons, the root's)."""
    length, mass = context.units.length, context.units.mass
    offset = root.number(f"{stem}offset", length) or 0.0
    rest = leaf.number(f"{leaf_stem}restLength", length, infinite=True)
    at_start = leaf is not root and (rest is None or rest < 0)
    rest = None if at_start else (rest or 0.0) - offset
    lower = leaf.number(f"{leaf_stem}lowerLimit", length, infinite=True)
    upper = leaf.number(f"{leaf_stem}upperLimit", length, infinite=True)
    return _Springs(
        root.number(f"{stem}stiffness", mass) or 0.0,
        root.number(f"{stem}damping", mass) or 0.0,
        root.number(f"{stem}limitStiffness", mass) or 0.0,
        rest,
        (-math.inf if lower is None else lower) - offset,
        (math.inf if upper is None else upper) - offset,
    )


# ---- fixed tendons -----------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Axis:
    """One joint of a fixed tendon: length for each rad or m, and force (None: not given)."""

    joint: str
    gearing: float
    force: float | None


def _add_fixed(context: Context, registry: Registry, root: Prim, name: str) -> None:
    stem = f"physxTendon:{name}:"
    if not root.flag(f"{stem}tendonEnabled", True):
        context.omit(root.path, f"the tendon {name!r}, which is disabled", "left out")
        return
    members = [root, *(prim for prim, other in _instances(context, AXIS) if other == name)]
    axes = [_axis(context, registry, prim, stem) for prim in dict.fromkeys(members)]
    problem = _why_not(axes)
    if problem is not None:
        context.omit(root.path, f"the fixed tendon {name!r}: {problem}", "left out")
        return
    found = [axis for axis in axes if axis is not None and axis.gearing]
    if any(axis.force is None for axis in found):
        text = f"tendon {name!r} gives no forceCoefficient; its force acts along its length"
        context.warn(text, root.path)
    ratio = 1.0 if found[0].force is None else found[0].force / found[0].gearing
    springs = _springs(context, root, stem, root, stem).scaled(ratio)
    for tendon in _sprung(context, registry, root, name, springs):
        for axis in found:
            tendon.wrap_joint(axis.joint, axis.gearing)


def _axis(context: Context, registry: Registry, prim: Prim, stem: str) -> _Axis | None:
    """A joint's part in a tendon; None where it is not one joint with one axis."""
    names = registry.joints.get(prim.path, [])
    if len(names) != 1 or registry.joint_types[names[0]] not in (_HINGE, _SLIDE):
        return None
    angular = registry.joint_types[names[0]] == _HINGE
    gearing = prim.numbers(f"{stem}gearing", None)
    force = prim.numbers(f"{stem}forceCoefficient", None)
    unit = context.units.length / DEGREE if angular else 1.0
    lever = context.units.length if angular else 1.0
    return _Axis(
        names[0],
        unit * (1.0 if gearing is None or not gearing.size else float(gearing.flat[0])),
        None if force is None or not force.size else lever * float(force.flat[0]),
    )


def _why_not(axes: list[_Axis | None]) -> str | None:
    """Why MuJoCo cannot have a fixed tendon; None if it can."""
    if None in axes:
        return "a joint of it has several axes, or none that moves"
    found = [axis for axis in axes if axis is not None and (axis.gearing or axis.force)]
    if not any(axis.gearing for axis in found):
        return "it runs along no joint"
    given = [axis for axis in found if axis.force is not None]
    if not given:
        return None
    if len(given) < len(found):
        return "only some of its joints give a forceCoefficient"
    ratios = [
        math.nan if not axis.gearing else (axis.force or 0.0) / axis.gearing for axis in given
    ]
    if not (np.isfinite(ratios).all() and np.allclose(ratios, ratios[0], rtol=_ALIKE, atol=0.0)):
        return "its forceCoefficients are not in proportion to its gearings"
    return None if ratios[0] > 0 else "its force acts against its length"


# ---- spatial tendons ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Attachment:
    """Where a spatial tendon is fixed to a link."""

    prim: Prim
    name: str

    @property
    def stem(self) -> str:
        """Beginning of its attributes' names."""
        return f"physxTendon:{self.name}:"

    def is_root(self) -> bool:
        """Whether the tendon begins here."""
        return f"{ATTACHMENT_ROOT}:{self.name}" in self.prim.flat.schemas


def _add_spatial(context: Context, registry: Registry, leaf: Prim, name: str) -> None:
    path = _path_to_root(context, _Attachment(leaf, name))
    problem = _why_not_spatial(registry, path)
    if problem is not None:
        context.omit(leaf.path, f"the spatial tendon {name!r}: {problem}", "left out")
        return
    end, root = path[0], path[-1]
    if not root.prim.flag(f"{root.stem}tendonEnabled", True):
        context.omit(leaf.path, f"the tendon {name!r}, which is disabled", "left out")
        return
    if len(path) > 2:
        text = f"tendon {name!r}: forces act at its intermediate attachments as well"
        context.warn(text, leaf.path)
    stretch = _gearing(end)
    springs = _springs(context, root.prim, root.stem, end.prim, end.stem).scaled(1.0, stretch)
    sites = [_site(context, registry, attachment) for attachment in reversed(path)]
    for tendon in _sprung(context, registry, leaf, name, springs):
        for site in sites:
            tendon.wrap_site(site)


def _path_to_root(context: Context, leaf: _Attachment) -> list[_Attachment]:
    """Attachments from a leaf to its root; shorter where a parent is missing."""
    path = [leaf]
    while not path[-1].is_root():
        here = path[-1]
        parent = context.target(here.prim, f"{here.stem}parentLink")
        token = here.prim.token(f"{here.stem}parentAttachment", "")
        found = context.prims.get(parent) if parent is not None else None
        if found is None or any((a.prim, a.name) == (found, token) for a in path):
            break
        path.append(_Attachment(found, token))
    return path


def _gearing(attachment: _Attachment) -> float:
    value = attachment.prim.number(f"{attachment.stem}gearing")
    return 1.0 if value is None else value


def _why_not_spatial(registry: Registry, path: list[_Attachment]) -> str | None:
    if not path[-1].is_root() or len(path) < 2:
        return "it does not lead to a root"
    if any(attachment.prim.path not in registry.bodies for attachment in path):
        return "an attachment is on no rigid body"
    gearings = [_gearing(attachment) for attachment in path[:-1]]
    if len(gearings) == 1:
        return None if gearings[0] > 0 else "its gearing is not positive"
    return None if gearings == [1.0] * len(gearings) else "its segments have gearings of their own"


def _site(context: Context, registry: Registry, attachment: _Attachment) -> str:
    """A site where a tendon is attached; `localPos` is scaled as the link is."""
    link = attachment.prim
    local = link.numbers(f"{attachment.stem}localPos", 3)
    position = context.place(link.path).point(np.zeros(3) if local is None else local)
    wanted = f"{registry.bodies[link.path]}_{attachment.name}"
    return add_marker(registry, link.path, Pose(pos=position), wanted)


# ---- both --------------------------------------------------------------------------------------


def _sprung(
    context: Context, registry: Registry, prim: Prim, name: str, springs: _Springs
) -> Iterator[mujoco.MjsTendon]:
    """A tendon with the spring and damper, and another one with the springs at the limits."""
    tendon = registry.spec.add_tendon(name=registry.tendon_names(name))
    tendon.damping = [springs.damping, 0, 0]
    tendon.stiffness = [springs.stiffness, 0, 0]
    if springs.stiffness and springs.rest is not None:
        tendon.springlength = [springs.rest] * 2
    yield tendon
    limited = math.isfinite(springs.lower) or math.isfinite(springs.upper)
    if not (limited and springs.limit_stiffness):
        return
    limits = registry.spec.add_tendon(name=registry.tendon_names(f"{name}_limits"))
    limits.stiffness = [springs.limit_stiffness, 0, 0]
    far = 1e6  # m; MuJoCo has no infinite dead bands
    limits.springlength = [max(springs.lower, -far), min(springs.upper, far)]
    yield limits
