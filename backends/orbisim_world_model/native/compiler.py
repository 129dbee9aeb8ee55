"""Compiles C with the system's compiler and keeps the result in the user's cache."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

from orbisim.errors import MissingDependencyError, OrbiSimError
from orbisim.files.temporary import temporary_folder

_FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-std=gnu11")


def compiled(source: str) -> Any:
    """The function `step` of a C file.

    Raises:
      MissingDependencyError: there is no C compiler.
      OrbiSimError: it does not compile the file.
    """
    compiler = next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), "")
    if not compiler:
        raise MissingDependencyError("the native step", "learned", "no C compiler (cc, gcc, clang)")
    key = hashlib.sha256("\0".join((source, compiler, *_FLAGS)).encode()).hexdigest()[:24]
    library = _cache() / f"step-{key}.so"
    if not library.exists():
        _build(compiler, source, library)
    function = ctypes.CDLL(str(library)).step
    function.restype = None
    return function


def _build(compiler: str, source: str, library: Path) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(library.parent, "build-") as folder:
        code, part, built = (folder / name for name in ("step.c", "step.o", "step.so"))
        code.write_text(source)
        # linked without -ffast-math, which would switch off denormal numbers in the whole process
        for command in (
            [compiler, *_FLAGS, "-c", str(code), "-o", str(part)],
            [compiler, "-shared", str(part), "-lm", "-o", str(built)],
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise OrbiSimError(f"{compiler} failed: {' '.join(done.stderr.split())[:300]}")
        built.replace(library)


def _cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home) / "orbisim" / "native"
