"""What every scene reader is, and what it returns: an `MjSpec`, and what it could not express."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any, ClassVar

import mujoco

from orbisim.errors import InputError


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


class Reader(abc.ABC):
    """Reads one scene format: a plug-in of the entry point group `orbisim.readers`.

    The entry point's name is the suffix without its dot (`urdf`); a reader of several suffixes is
    registered under each.

    Attributes:
      format: its name, for messages ("URDF"). suffix: the one it usually has (".urdf").
      root: name of the root element, where the format is XML: by it, documents given as strings
        find their reader.
      isolated: whether `read` bounds time and memory itself; otherwise files that are not trusted
        are first read in a child process that is bounded.
    """

    format: ClassVar[str]
    suffix: ClassVar[str]
    root: ClassVar[str | None] = None
    isolated: ClassVar[bool] = False

    @abc.abstractmethod
    def read(self, path: str, **options: Any) -> ReadResult:
        """Reads the file at `path`.

        Raises:
          SceneError: it is broken, hostile or not of this format; the message names the element.
          InputError: an option is unknown or wrong.
        """

    def read_string(self, text: str, **options: Any) -> ReadResult:
        """Reads a document.

        Raises:
          SceneError: as `read`.
          InputError: as `read`; or the format has no text form.
        """
        raise InputError(f"{self.format} is read from files only; save the document and name it")
