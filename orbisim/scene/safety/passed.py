"""Which scenes came through the guard: those need no child process again.

A scene is what its document and every file that it led to hold, read by one version of the reader
and of MuJoCo with the same options. If any of them differs it is a new scene.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import mujoco

from orbisim.files.checked import digest_of, key_of, recall, remember, signature_of
from orbisim.scene.safety.confine import confinement
from orbisim.version import VERSION

_SEARCHED = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
"""Variables that say where a document's files are."""


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A scene that is about to be read.

    Attributes:
      path: of its document. key: under which it is kept; None where nothing is (archives, whose
        files are gone afterwards).
      since: when reading began, ns.
    """

    path: str
    key: str | None
    since: int

    @staticmethod
    def of(path: Path, reader: object, options: Mapping[str, Any]) -> Candidate:
        """A document, what reads it, and how."""
        since = time.time_ns()
        if confinement() is not None:
            return Candidate(str(path), None, since)
        name = str(path.resolve())
        places = [os.environ.get(variable, "") for variable in _SEARCHED]
        how = (type(reader).__qualname__, repr(sorted(options.items())), *places, str(Path.cwd()))
        return Candidate(name, key_of("scene", VERSION, mujoco.__version__, name, *how), since)

    def passed_before(self) -> bool:
        """Whether exactly this came through before."""
        known = recall(self.key) if self.key is not None else None
        files = known.get("files") if known is not None else None
        if not isinstance(files, dict) or self.path not in files:
            return False
        try:
            return all(digest_of(file) == digest for file, digest in files.items())
        except OSError:
            return False

    def passed(self, files: Iterable[str]) -> None:
        """It came through, and led to these files."""
        if self.key is None:
            return
        names = dict.fromkeys([self.path, *(str(Path(file).resolve()) for file in files)])
        try:
            digests = {name: digest_of(name) for name in names}
            untouched = all(max(signature_of(name)[-2:]) < self.since for name in names)
        except OSError:
            return
        if untouched:  # else it may not be what was read
            remember(self.key, {"files": digests})
