"""Decides the mass properties of every link: as declared, repaired, or inferred."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import trimesh

from orbisim.errors import SceneError
from orbisim.scene.urdf import inertia
from orbisim.scene.urdf.assembly import Body, Member
from orbisim.scene.urdf.inertia import MINIMUM, NEGLIGIBLE
from orbisim.scene.urdf.model import Inertial, Link, Shape


@dataclasses.dataclass
class Inferrer:
    """Infers mass properties from geometry, and says so.

    Attributes:
      source: named in errors.
      mesh: loads the mesh of a shape, scaled.
      rule: name of the rule for meshes (`inertia.MESH_RULES`).
      balanced, bounded: whether MuJoCo's compiler was asked to repair violations of the triangle
        inequality, and masses that are too small.
      warnings: what was assumed.
    """

    source: str
    mesh: Callable[[Shape], trimesh.Trimesh]
    rule: str
    balanced: bool = False
    bounded: bool = False
    warnings: list[str] = dataclasses.field(default_factory=list)

    def all(self, groups: Sequence[Body], *, skip_static: bool) -> dict[str, Inertial]:
        """Mass properties by link; links without mass are left out.

        Args:
          groups: the bodies with fixed joints lumped.
          skip_static: leave out links that are part of the world.
        """
        found: dict[str, Inertial] = {}
        for group in groups:
            if skip_static and not group.moves:
                continue
            for member in group.members:
                properties = self._declared_or_solid(member.link)
                if properties is not None:
                    found[member.link.name] = properties
        if not self.bounded:
            self._give_weights(groups, found)
        return found

    def _declared_or_solid(self, link: Link) -> Inertial | None:
        """What the document declares, repaired; else the link's collision geometry, if any."""
        given = link.inertial
        if given is not None:
            return self._sound(link, given)
        if not link.collisions:
            return None
        solid = self._solid(link.collisions)
        if solid is not None:
            self._assumed(link, "declares no inertia", "collision", solid)
        return solid

    def _sound(self, link: Link, given: Inertial) -> Inertial:
        problem = inertia.problem_with(given)
        if problem is None or (self.balanced and "triangle" in problem):
            return given
        close = inertia.rounded(given)
        if close is not None:
            self.warnings.append(f"{link.label}: {problem}; taken as rounding and lowered to fit")
            return close
        shapes, solid = self._geometry(link)
        if given.mass > MINIMUM:
            self._assumed_tensor(link, problem, shapes, given.mass)
            return inertia.with_mass(given.mass, given.com, solid)
        if solid is None:
            raise SceneError(
                self.source,
                f"{problem}, and it has no geometry to infer it from",
                element=link.label,
                remedy="give a positive mass",
            )
        self._assumed(link, problem, shapes, solid)
        return solid

    def _give_weights(self, groups: Sequence[Body], found: dict[str, Inertial]) -> None:
        """Makes mass and inertia of every body that moves positive, as MuJoCo requires."""
        carried = dict.fromkeys((group.name for group in groups), 0.0)
        for group in reversed(groups):  # children first
            own = sum(found[m.link.name].mass for m in group.members if m.link.name in found)
            if group.moves:
                self._give_weight(group, carried[group.name] > 0, found)
            if group.parent is not None:
                carried[group.parent] += own + carried[group.name]

    def _give_weight(self, group: Body, carries: bool, found: dict[str, Inertial]) -> None:
        parts = [moved(found[m.link.name], m) for m in group.members if m.link.name in found]
        if _has_weight(parts):
            return
        for member in group.members:
            link, given = member.link, found.get(member.link.name)
            shapes, solid = self._geometry(link)
            if given is not None and given.mass > MINIMUM:
                self._assumed_tensor(link, "its inertia is zero", shapes, given.mass)
                found[link.name] = inertia.with_mass(given.mass, given.com, solid)
                return
            if solid is not None:
                why = "its mass is zero" if given else "declares no inertia"
                self._assumed(link, why, shapes, solid)
                found[link.name] = solid
                return
        self._give_something(group.members[0].link, carries, found)

    def _give_something(self, link: Link, carries: bool, found: dict[str, Inertial]) -> None:
        """A negligible mass for a frame: one that declares none, or that others hang on."""
        if link.inertial is not None and not carries:
            raise SceneError(
                self.source,
                "moves, its mass is zero, and it has no geometry to infer it from",
                element=link.label,
                remedy="give a positive mass",
            )
        found[link.name] = NEGLIGIBLE
        what = "declares no inertia" if link.inertial is None else "its mass is zero"
        self.warnings.append(
            f"{link.label}: moves, {what}, and it has no geometry; given a negligible mass of "
            f"{NEGLIGIBLE.mass:g} kg and moments of {NEGLIGIBLE.tensor[0, 0]:g} kg*m^2"
        )

    def _geometry(self, link: Link) -> tuple[str, Inertial | None]:
        """Mass properties of the collision geometry, else of the visual one."""
        for kind, shapes in (("collision", link.collisions), ("visual", link.visuals)):
            solid = self._solid(shapes)
            if solid is not None:
                return kind, solid
        return "no", None

    def _solid(self, shapes: Sequence[Shape]) -> Inertial | None:
        return inertia.of_shapes(shapes, self.mesh, inertia.MESH_RULES[self.rule])

    def _assumed(self, link: Link, why: str, shapes: str, solid: Inertial) -> None:
        self.warnings.append(
            f"{link.label}: {why}; inferred {solid.mass:.6g} kg from its {shapes} geometry at "
            f"{inertia.DENSITY:g} kg/m^3{self._exact_note(link, shapes, solid)}"
        )

    def _assumed_tensor(self, link: Link, why: str, shapes: str, mass: float) -> None:
        form = f"its {shapes} geometry" if shapes != "no" else "a solid sphere"
        self.warnings.append(
            f"{link.label}: {why}; its moments are inferred from {form} with its mass, {mass:g} kg"
        )

    def _exact_note(self, link: Link, kind: str, solid: Inertial) -> str:
        """Says so where MuJoCo's rule for meshes is far off."""
        shapes = link.collisions if kind == "collision" else link.visuals
        if self.rule != "legacy" or not any(shape.kind == "mesh" for shape in shapes):
            return ""
        exact = inertia.of_shapes(shapes, self.mesh, inertia.exact)
        if exact is None or abs(exact.mass / solid.mass - 1) < 0.01:
            return ""
        return (
            f" by MuJoCo's rule for meshes; the closed meshes have {exact.mass:.6g} kg "
            "(mesh_inertia='exact')"
        )


def moved(inertial: Inertial, member: Member) -> Inertial:
    """Mass properties of a link in the frame of its body."""
    return Inertial(
        inertial.mass,
        member.pos + member.rotation @ inertial.com,
        member.rotation @ inertial.tensor @ member.rotation.T,
    )


def of_body(body: Body, by_link: Mapping[str, Inertial]) -> Inertial | None:
    """Mass properties of a body in its own frame; None if it has none."""
    parts = [moved(by_link[m.link.name], m) for m in body.members if m.link.name in by_link]
    if len(parts) == 1:
        return parts[0]
    heavy = [part for part in parts if part.mass > 0]  # moments without mass do not count
    return inertia.total(heavy) if heavy else None


def _has_weight(parts: Sequence[Inertial]) -> bool:
    heavy = [part for part in parts if part.mass > 0]
    if not heavy:
        return False
    whole = inertia.total(heavy)
    moments = np.linalg.eigvalsh(whole.tensor)
    return whole.mass > MINIMUM and bool(moments[0] > MINIMUM)
