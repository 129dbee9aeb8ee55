"""What every scene reader returns: an `MjSpec`, and what it could not express."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import mujoco


@dataclasses.dataclass(frozen=True)
class Unsupported:
    """Something in the source file that the scene does not carry.

    Attributes:
      element: where it stands (tag and name in XML, prim path in USD).
      feature: what it is, in the source format's own words.
      consequence: what the scene does instead.
    """

    element: str
    feature: str
    consequence: str

    def __str__(self) -> str:
        return f"{self.element}: {self.feature} ({self.consequence})"


@dataclasses.dataclass(frozen=True)
class ReadResult:
    """A scene as read, not yet compiled.

    Attributes:
      spec: the editable MuJoCo model.
      unsupported: what the reader had to leave out; never empty in silence.
      warnings: what the reader had to assume (an inertia inferred from a mesh, say).
    """

    spec: mujoco.MjSpec
    unsupported: tuple[Unsupported, ...] = ()
    warnings: tuple[str, ...] = ()


class Reader(Protocol):
    """Reads one scene format.

    Raises `orbisim.errors.SceneError` on input that is broken, hostile or not of this format.
    """

    def __call__(self, path: str, **options: Any) -> ReadResult:
        """Reads the file at `path`."""
        ...
