"""Tendons: MuJoCo's own, and distance joints."""

from __future__ import annotations

import mujoco

from orbisim.scene.usd import tables
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.joints import Joint
from orbisim.scene.usd.registry import Registry
from orbisim.scene.usd.sites import add_marker
from orbisim.scene.usd.tables import Field

_FIELDS = (
    Field("mjc:springlength", "springlength", tables.vector),
    Field("mjc:frictionloss", "frictionloss", tables.number),
    Field("mjc:solreffriction", "solref_friction", tables.vector),
    Field("mjc:solimpfriction", "solimp_friction", tables.vector),
    Field("mjc:armature", "armature", tables.number),
    Field("mjc:limited", "limited", tables.limited),
    Field("mjc:actuatorfrclimited", "actfrclimited", tables.limited),
    Field("mjc:range", "range", tables.bounds),
    Field("mjc:actuatorfrcrange", "actfrcrange", tables.bounds),
    Field("mjc:margin", "margin", tables.number),
    Field("mjc:solreflimit", "solref_limit", tables.vector),
    Field("mjc:solimplimit", "solimp_limit", tables.vector),
    Field("mjc:rgba", "rgba", tables.vector),
    Field("mjc:width", "width", tables.number),
    Field("mjc:group", "group", tables.integer),
)


def add_tendons(context: Context, registry: Registry) -> None:
    """Adds all `MjcTendon` prims."""
    for prim in context.of_type("MjcTendon"):
        _add(context, registry, prim)


def _add(context: Context, registry: Registry, prim: Prim) -> None:
    steps = _path(prim)
    fixed = prim.choice("mjc:type", ("spatial", "fixed"), "spatial") == "fixed"
    known = _joints(registry) if fixed else {*registry.sites, *registry.geoms}
    missing = [target for target, _ in steps if target not in known]
    if missing or not steps:
        what = f"<{missing[0]}>, which it cannot run along" if missing else "nothing"
        context.omit(prim.path, f"MjcTendon along {what}", "left out")
        prim.use(*prim.flat.attributes, *prim.flat.relationships)
        return
    name = registry.tendon_names(prim.flat.display_name or prim.flat.name)
    tendon = registry.spec.add_tendon(name=name)
    tables.apply(_FIELDS, prim, tendon)
    tendon.stiffness = [prim.number("mjc:stiffness") or 0.0, 0, 0]
    tendon.damping = [prim.number("mjc:damping") or 0.0, 0, 0]
    if fixed:
        _wrap_joints(prim, registry, tendon, steps)
    else:
        _wrap_space(prim, registry, tendon, steps)
    registry.tendons[prim.path] = name


def _joints(registry: Registry) -> set[str]:
    return {path for path, names in registry.joints.items() if names}


def _path(prim: Prim) -> list[tuple[str, int]]:
    """What the tendon runs along: target, and index of the step."""
    targets = prim.targets("mjc:path")
    indices = prim.numbers("mjc:path:indices", None)
    order = range(len(targets)) if indices is None else [int(i) for i in indices]
    if any(not 0 <= i < len(targets) for i in order):
        raise prim.error(f"mjc:path:indices leads beyond the {len(targets)} targets of mjc:path")
    return [(targets[i], step) for step, i in enumerate(order)]


def _wrap_joints(
    prim: Prim, registry: Registry, tendon: mujoco.MjsTendon, steps: list[tuple[str, int]]
) -> None:
    coefficients = prim.numbers("mjc:path:coef", len(steps))
    for path, step in steps:
        coefficient = 1.0 if coefficients is None else float(coefficients[step])
        tendon.wrap_joint(registry.joints[path][0], coefficient)


def _wrap_space(
    prim: Prim, registry: Registry, tendon: mujoco.MjsTendon, steps: list[tuple[str, int]]
) -> None:
    """Sites and wrapping geoms; segments with divisors are what MuJoCo separates by pulleys."""
    segments = _each(prim, "mjc:path:segments", 0, len(steps))
    sides = _each(prim, "mjc:sideSites:indices", -1, len(steps))
    side_sites = prim.targets("mjc:sideSites")
    divisors = prim.numbers("mjc:path:divisors", None)
    factors = [] if divisors is None else divisors.tolist()
    current = 0
    if factors and factors[0] != 1.0:
        tendon.wrap_pulley(factors[0])
    for path, step in steps:
        if segments[step] != current:
            current = segments[step]
            tendon.wrap_pulley(factors[current] if 0 <= current < len(factors) else 1.0)
        if path in registry.sites:
            tendon.wrap_site(registry.sites[path])
        else:
            side = sides[step]
            site = side_sites[side] if 0 <= side < len(side_sites) else ""
            tendon.wrap_geom(registry.geoms[path][0], registry.sites.get(site, ""))


def _each(prim: Prim, name: str, otherwise: int, count: int) -> list[int]:
    """One whole number for each step of a path."""
    values = prim.numbers(name, count)
    return [otherwise] * count if values is None else [int(value) for value in values]


def add_distance(context: Context, registry: Registry, joint: Joint) -> None:
    """A distance joint as a tendon with limits between two sites."""
    first = add_marker(registry, joint.body0, joint.frame0, f"{joint.prim.flat.name}_0")
    second = add_marker(registry, joint.body1, joint.frame1, f"{joint.prim.flat.name}_1")
    name = registry.tendon_names(joint.prim.flat.display_name or joint.prim.flat.name)
    tendon = registry.spec.add_tendon(name=name)
    tendon.wrap_site(first)
    tendon.wrap_site(second)
    assert joint.distance is not None
    if joint.distance[1] < 1e9 or joint.distance[0] > 0:
        tendon.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        tendon.range = [*joint.distance]
    registry.tendons[joint.path] = name
