"""What the viewer shows and how: one frozen value."""

from __future__ import annotations

import dataclasses
from typing import Literal

from orbisim.errors import InputError

RGB = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Theme:
    """Colours of everything that is not part of the scene, each in [0, 1].

    Attributes:
      top, bottom: the background, a vertical gradient.
      grid: lines of the floor grid.
    """

    top: RGB
    bottom: RGB
    grid: RGB


THEMES = {
    "light": Theme(top=(0.98, 0.985, 0.99), bottom=(0.83, 0.86, 0.90), grid=(0.45, 0.5, 0.56)),
    "dark": Theme(top=(0.13, 0.16, 0.20), bottom=(0.05, 0.06, 0.08), grid=(0.5, 0.55, 0.6)),
}

_NGROUP = 6
"""MuJoCo's `mjNGROUP`."""


@dataclasses.dataclass(frozen=True)
class ViewOptions:
    """What to show.

    The defaults show what MuJoCo's own viewer shows when it opens, without sites and skins.

    Attributes:
      groups: the groups of geoms, flexes, skins, sites and tendons that are shown (MuJoCo's
        `group`, 0 to 5). Readers put collision geoms that have a visual twin into group 3.
      sites: whether to show sites.
      tendons: whether to show tendons, as lines.
      contacts: whether to show contacts, as their normals. They are what C MuJoCo finds at the
        positions shown, whatever backend computed these.
      skins: whether to show skins; in a saved page each frame stores every vertex.
      background: `light` or `dark`.
      azimuth, elevation: direction of the first view, degrees, as in MJCF's `<visual><global>`;
        None for what the scene says.
      max_faces: meshes with more triangles are simplified to about this many; None to keep all.
      shadows: whether the main light casts shadows.

    Raises:
      InputError: a value is out of range.
    """

    groups: tuple[int, ...] = (0, 1, 2)
    sites: bool = False
    tendons: bool = False
    contacts: bool = False
    skins: bool = False
    background: Literal["light", "dark"] = "light"
    azimuth: float | None = None
    elevation: float | None = None
    max_faces: int | None = None
    shadows: bool = True

    def __post_init__(self) -> None:
        wrong = [g for g in self.groups if not 0 <= g < _NGROUP]
        if wrong:
            raise InputError(f"groups are numbers from 0 to {_NGROUP - 1}; got {wrong[0]}")
        if self.background not in THEMES:
            raise InputError(f"background is {' or '.join(THEMES)}; got {self.background!r}")
        if self.max_faces is not None and self.max_faces < 4:
            raise InputError(f"max_faces must be at least 4; got {self.max_faces}")

    @property
    def theme(self) -> Theme:
        """The colours that go with the background."""
        return THEMES[self.background]

    def group_mask(self) -> list[int]:
        """[6] of 0 and 1, as in `mujoco.MjvOption.geomgroup`."""
        return [int(group in self.groups) for group in range(_NGROUP)]


@dataclasses.dataclass(frozen=True)
class Look:
    """How one copy of the scene is drawn.

    Attributes:
      root: path of the copy in the viewer's tree.
      tint: colour that replaces every other, for a ghost; None for the scene's own colours.
      opacity: of a ghost.
    """

    root: str
    tint: RGB | None = None
    opacity: float = 1.0

    @property
    def ghost(self) -> bool:
        """Whether this is a ghost: one colour, transparent, moving parts only."""
        return self.tint is not None


SOLID = Look("/scene")
GHOST = Look("/ghost", tint=(0.95, 0.45, 0.05), opacity=0.45)
