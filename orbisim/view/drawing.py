"""A copy of a scene as meshcat commands: what draws it, and what moves it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.view.deforming import deforming_parts
from orbisim.view.kinematics import Kinematics, is_static
from orbisim.view.materials import flattened, ghostly, phong, texture_mapping, texture_of
from orbisim.view.options import SOLID, Look, ViewOptions
from orbisim.view.parts import Part, node_name, visible_parts
from orbisim.view.shapes import Shape, shape_of
from orbisim.view.three import Json, drawable, set_transform

_FLOORS_FIRST = -1
"""`renderOrder` of planes: a transparent floor must be there before what stands on it."""


class Drawing:
    """One copy of a scene in the viewer's tree.

    Every body that carries something visible is a node under the copy's root, placed in the
    world; its geoms are nodes below it and never move.

    Args:
      model: the scene's model.
      options: what to show.
      look: the scene itself, or a ghost of it. A ghost consists of what moves.

    Attributes:
      kinematics: what places it.
      bodies: path of each body's node, by number.
      moving: those that can move.
      deforming: what changes shape.
    """

    def __init__(
        self, model: mujoco.MjModel, options: ViewOptions | None = None, look: Look = SOLID
    ) -> None:
        self.model, self.options, self.look = model, options or ViewOptions(), look
        self.kinematics = Kinematics(model, self.options.contacts and not look.ghost)
        self.parts = [
            part
            for part in visible_parts(self.kinematics, self.options)
            if not (look.ghost and is_static(model, part.body))
        ]
        self.bodies = {part.body: self._body_path(part.body) for part in self.parts}
        self.moving = [body for body in self.bodies if not is_static(model, body)]
        self.deforming = list(deforming_parts(model, self.options, look))

    def place(
        self, qpos: npt.NDArray[np.floating[Any]], memory: Mapping[str, Any] | None = None
    ) -> None:
        """Moves the copy (see `Kinematics.place`); the commands say how it is now."""
        self.kinematics.place(qpos, memory)

    def create(self) -> Iterator[Json]:
        """Commands that draw everything where it is now."""
        for body, path in self.bodies.items():
            yield set_transform(path, self.kinematics.body_matrix(body))
        for part in self.parts:
            yield from self._create_part(part)
        for deforming in self.deforming:
            yield deforming.create(self.kinematics.data)

    def update(self) -> Iterator[Json]:
        """Commands that move what can move to where it is now."""
        for body in self.moving:
            yield set_transform(self.bodies[body], self.kinematics.body_matrix(body))
        for deforming in self.deforming:
            yield deforming.update(self.kinematics.data)

    def part_path(self, part: Part) -> str:
        """Path of a geom's or site's node."""
        return f"{self.bodies[part.body]}/{part.name}"

    def _body_path(self, body: int) -> str:
        name = node_name(self.model, mujoco.mjtObj.mjOBJ_BODY, body)
        return f"{self.look.root}/{name}"

    def _create_part(self, part: Part) -> Iterator[Json]:
        path = self.part_path(part)
        shape, material = self._dressed(part)
        plane = part.kind == mujoco.mjtGeom.mjGEOM_PLANE
        solid = not plane and not material["transparent"]
        yield drawable(
            path,
            shape.geometry,
            material,
            matrix=shape.matrix,
            renderOrder=_FLOORS_FIRST if plane else 0,
            userData={"castShadow": solid, "receiveShadow": not self.look.ghost},
        )
        yield set_transform(path, part.matrix)

    def _dressed(self, part: Part) -> tuple[Shape, Json]:
        """The shape and material of a part."""
        limit = self.options.max_faces
        if self.look.ghost:
            return shape_of(self.model, part, None, limit), ghostly(self.look)
        mapping = texture_mapping(self.model, part.appearance, part.size)
        shape = shape_of(self.model, part, mapping, limit)
        texture, appearance = None, part.appearance
        if shape.mapped:
            texture = texture_of(self.model, appearance)
        else:
            appearance = flattened(self.model, appearance)
        return shape, phong(
            appearance, side=shape.side, texture=texture, fades=shape.fades, flat=shape.flat
        )
