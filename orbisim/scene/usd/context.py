"""What all parts of the reader share while one stage is read."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from orbisim.errors import SceneError
from orbisim.scene.reading import Unsupported
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.flat import FlatStage, ancestors
from orbisim.scene.usd.pose import Placement, split
from orbisim.scene.usd.units import DEGREE, Units


@dataclasses.dataclass
class Context:
    """One stage being read.

    Attributes:
      source: the file, as the user named it.
      stage: the dumped stage.
      prims: its prims by path, in the stage's order.
      units: its units.
      decompose: whether meshes that collide as they are may be split into convex parts.
      misfits: joints that the authored poses violate: path, m, rad.
    """

    source: str
    stage: FlatStage
    prims: Mapping[str, Prim]
    units: Units
    decompose: bool = False
    misfits: list[tuple[str, float, float]] = dataclasses.field(default_factory=list)
    _omitted: dict[tuple[str, str], dict[str, None]] = dataclasses.field(default_factory=dict)
    _warned: dict[str, dict[str, None]] = dataclasses.field(default_factory=dict)
    _placements: dict[str, Placement] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        self._types: dict[str, list[Prim]] = {}
        self._schemas: dict[str, list[Prim]] = {}
        for prim in self.prims.values():
            self._types.setdefault(prim.flat.type_name, []).append(prim)
            for schema in prim.flat.schemas:
                self._schemas.setdefault(schema, []).append(prim)
        self.for_mujoco = bool(self._schemas.keys() & {"MjcSceneAPI", "MjcJointAPI"})
        self.mjc_angle = DEGREE if self._mjc_degrees() else 1.0

    def omit(self, element: str, feature: str, consequence: str) -> None:
        """Lists something that the scene does not carry."""
        self._omitted.setdefault((feature, consequence), {}).setdefault(element)

    def warn(self, text: str, element: str = "") -> None:
        """Lists something that had to be assumed, about a prim or the whole stage."""
        self._warned.setdefault(text, {}).setdefault(element)

    @property
    def unsupported(self) -> tuple[Unsupported, ...]:
        """What the scene does not carry; one line for all elements of which the same is true."""
        return tuple(
            Unsupported(_some_of(list(elements)), feature, consequence)
            for (feature, consequence), elements in self._omitted.items()
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What had to be assumed; one line for all elements of which the same is true."""
        return tuple(
            f"{_some_of(list(elements))}: {text}" if any(elements) else text
            for text, elements in self._warned.items()
        )

    def place(self, path: str) -> Placement:
        """Where a prim is in the world; m, z up."""
        if path not in self._placements:
            self._placements[path] = self.units.place(self.prims[path].flat.matrix)
        return self._placements[path]

    def relative(self, path: str, owner: str | None) -> Placement:
        """Where a prim is in the rigid frame of another (the world for None).

        Below the owner the transforms in between are multiplied, so that what is written there
        arrives without rounding.
        """
        if owner is None:
            return self.place(path)
        frame = self.place(owner)
        matrix = np.eye(4)
        for step in ancestors(path):
            if step == owner:
                stretched = np.eye(4)
                stretched[:3, :3] = frame.stretch
                return split(stretched @ matrix)
            if step not in self.prims or self.prims[step].flat.resets:
                break
            matrix = self.prims[step].flat.local @ matrix
        here = self.place(path)
        return dataclasses.replace(here, pose=frame.pose.inverse() @ here.pose)

    def of_type(self, *types: str) -> list[Prim]:
        """Prims of the given types, in the stage's order."""
        if len(types) == 1:
            return self._types.get(types[0], [])
        return [prim for prim in self.prims.values() if prim.flat.type_name in types]

    def with_schema(self, schema: str) -> list[Prim]:
        """Prims to which an API schema is applied, in the stage's order."""
        return self._schemas.get(schema, [])

    def lineage(self, path: str) -> Iterator[Prim]:
        """A prim and its ancestors, nearest first."""
        return (self.prims[step] for step in ancestors(path) if step in self.prims)

    def target(self, prim: Prim, relationship: str) -> str | None:
        """The one prim that a relationship leads to; None if it leads nowhere.

        Raises:
          SceneError: it leads to a prim that does not exist.
        """
        targets = prim.targets(relationship)
        if not targets:
            return None
        if targets[0] not in self.prims:
            raise prim.error(
                f"{relationship} leads to <{targets[0]}>, which does not exist",
                "name an existing prim, or leave the relationship out for the world",
            )
        if len(targets) > 1:
            self.omit(prim.path, f"{len(targets)} targets of {relationship}", "the first is used")
        return targets[0]

    def error(self, problem: str, element: str | None = None) -> SceneError:
        """An error about the stage."""
        return SceneError(self.source, problem, element=element)

    def _mjc_degrees(self) -> bool:
        """Whether angles in `mjc:` attributes are degrees, MuJoCo's default in files."""
        for prim in self.of_type("PhysicsScene"):
            return prim.choice("mjc:compiler:angle", ("degree", "radian"), "degree") == "degree"
        return True


def _some_of(elements: Sequence[str]) -> str:
    """The first element, and how many more there are."""
    return elements[0] if len(elements) == 1 else f"{elements[0]} and {len(elements) - 1} more"
