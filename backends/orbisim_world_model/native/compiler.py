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

_COMMON = ("-march=native", "-ffast-math", "-fPIC", "-std=gnu11")
_FLAGS = ("-O3", *_COMMON)
_CAREFUL = ("-O2", "-ftree-vectorize", *_COMMON)
"""For steps with contacts: from -O3 GCC 12 takes minutes, and gets comparisons of strided rows
wrong (see the test with contacts)."""


def compiled(source: str, careful: bool = False) -> Any:
    """The function `step` of a C file.

    Args:
      source: the file.
      careful: see `_CAREFUL`.

    Raises:
      MissingDependencyError: there is no C compiler.
      OrbiSimError: it does not compile the file.
    """
    compiler = next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), "")
    if not compiler:
        raise MissingDependencyError("the native step", "learned", "no C compiler (cc, gcc, clang)")
    flags = _CAREFUL if careful else _FLAGS
    key = hashlib.sha256("\0".join((source, compiler, *flags)).encode()).hexdigest()[:24]
    library = _cache() / f"step-{key}.so"
    if not library.exists():
        _build(compiler, flags, source, library)
    function = ctypes.CDLL(str(library)).step
    function.restype = None
    return function


def _build(compiler: str, flags: tuple[str, ...], source: str, library: Path) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(library.parent, "build-") as folder:
        code, part, built = (folder / name for name in ("step.c", "step.o", "step.so"))
        code.write_text(source)
        # linked without -ffast-math, which would switch off denormal numbers in the whole process
        for command in (
            [compiler, *flags, "-c", str(code), "-o", str(part)],
            [compiler, "-shared", str(part), "-lm", "-o", str(built)],
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise OrbiSimError(f"{compiler} failed: {' '.join(done.stderr.split())[:300]}")
        built.replace(library)


def _cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home) / "orbisim" / "native"
