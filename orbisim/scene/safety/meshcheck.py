"""Checks the mesh files that MuJoCo itself decodes, each content once."""

from __future__ import annotations

from pathlib import Path

from orbisim.errors import SceneError
from orbisim.files.checked import digest_of, key_of, recall, remember
from orbisim.scene.safety.confine import confinement
from orbisim.scene.safety.meshformats import CHECKED_WHOLE, CHECKS, Findings, check_presence
from orbisim.scene.safety.problem import MeshProblemError


def check_native_mesh(
    path: str | Path, *, source: str | None = None, element: str | None = None
) -> Findings:
    """Refuses an STL, OBJ or MSH file that is broken or hostile; says what it holds.

    Args:
      path: the file. source: the scene that refers to it, for the message; the mesh file itself by
        default. element: the element of the scene that refers to it.

    Raises:
      SceneError: as `orbisim.scene.safety.meshes.check_mesh_file`.
    """
    path = Path(path)
    with Blame(path, source, element):
        check_presence(path)
        suffix = path.suffix.lower()
        if suffix not in CHECKED_WHOLE:
            raise MeshProblemError(
                f"has the suffix {suffix or 'none'!r}; expected one of {', '.join(CHECKED_WHOLE)}"
            )
        if confinement() is not None:  # what it refers to has to stay inside
            return CHECKS[suffix](path)
        digest = digest_of(path)
        key = key_of("mesh", suffix, digest)
        known = recall(key)
        if known is not None:
            return Findings(bool(known.get("several_objects")))
        found = CHECKS[suffix](path)
        if digest_of(path) == digest:  # else it was written to meanwhile
            remember(key, {"several_objects": found.several_objects})
        return found


class Blame:
    """Turns a `MeshProblemError` into a `SceneError` that names mesh file, scene and element."""

    def __init__(self, path: Path, source: str | None, element: str | None) -> None:
        self._path, self._source, self._element = path, source, element

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            error = MeshProblemError(f"cannot be read: {error.strerror or error}")
        if not isinstance(error, MeshProblemError):
            return
        problem = f"mesh file {str(self._path)!r} {error}" if self._source else str(error)
        raise SceneError(
            self._source or str(self._path),
            problem,
            element=self._element,
            remedy=error.remedy or "repair or replace the mesh file",
        ) from None
