"""What a URDF document says, as typed values with every number checked.

Frames are a position in m and a rotation matrix; angles are radians.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import numpy.typing as npt

from orbisim.scene.reading import Unsupported
from orbisim.scene.safety.xmlsafe import Node

Array = npt.NDArray[np.float64]
Rgba = tuple[float, float, float, float]
ShapeKind = Literal["box", "cylinder", "sphere", "capsule", "mesh"]
WORLD = "world"
"""A root link of this name is the world itself."""


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """One visual or collision element.

    Attributes:
      label: for messages.
      name: the element's name, may be empty.
      size: box: three edges; cylinder and capsule: radius and length; sphere: radius. In m.
      file: of a mesh, as written.
      scale: of a mesh.
      rgba: colour, where the element's material has one.
      textured: whether the material names an image.
    """

    label: str
    name: str
    kind: ShapeKind
    pos: Array
    rotation: Array
    size: tuple[float, ...] = ()
    file: str = ""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    rgba: Rgba | None = None
    textured: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Inertial:
    """Mass properties.

    Attributes:
      mass: kg.
      com: centre of mass in the link's frame, m.
      tensor: [3, 3] about the centre of mass, along the link's axes, kg*m^2; NaN where the
        document gives a mass alone.
    """

    mass: float
    com: Array
    tensor: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Link:
    """One link; `inertial` is None where the document declares none."""

    label: str
    name: str
    inertial: Inertial | None
    collisions: tuple[Shape, ...]
    visuals: tuple[Shape, ...]


@dataclasses.dataclass(frozen=True)
class Mimic:
    """The joint's position is `multiplier` times that of `joint` plus `offset`."""

    joint: str
    multiplier: float
    offset: float


@dataclasses.dataclass(frozen=True, eq=False)
class Joint:
    """One joint; numbers that the document leaves out are None.

    Attributes:
      pos, rotation: frame of the child link in that of the parent, all joints at zero.
      axis: in the child's frame, not normalised.
      lower, upper: limits, rad or m.
      effort, velocity: limits, N*m or N and rad/s or m/s.
    """

    label: str
    name: str
    type: str
    parent: str
    child: str
    pos: Array
    rotation: Array
    axis: Array
    damping: float = 0.0
    friction: float = 0.0
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    mimic: Mimic | None = None


@dataclasses.dataclass(frozen=True)
class Transmission:
    """Joint torque is `reduction` times actuator torque."""

    label: str
    joint: str
    actuator: str
    reduction: float


@dataclasses.dataclass(frozen=True)
class Robot:
    """A whole document.

    Attributes:
      root: name of the link without a parent.
      extension: the `<mujoco>` element, MuJoCo's extension of URDF.
      own_extension: the `<orbisim>` element.
      unsupported: elements that no part of the scene stands for.
    """

    name: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    transmissions: tuple[Transmission, ...]
    root: str
    extension: Node | None
    own_extension: Node | None
    unsupported: tuple[Unsupported, ...]
    warnings: tuple[str, ...]

    def children(self) -> dict[str, list[Joint]]:
        """For each link the joints to its children, in the order of the document."""
        found: dict[str, list[Joint]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            found[joint.parent].append(joint)
        return found
