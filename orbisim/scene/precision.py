"""MuJoCo's XML writer with all digits."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator
from pathlib import Path

import mujoco

_FULL_DIGITS = 17
"""With so many, every float64 is read back as it was."""


@contextlib.contextmanager
def full_precision() -> Iterator[None]:
    """Makes MuJoCo's XML writer print 17 digits instead of 6.

    The setting is an exported but undocumented function of the library; `tests/scene` checks
    that a saved scene compiles to the same model.
    """
    libraries = sorted(Path(mujoco.__file__).parent.glob("libmujoco.so*"))
    library = ctypes.CDLL(str(libraries[0])) if libraries else ctypes.CDLL(None)
    setter = library._mjPRIVATE__set_xml_precision
    getter = library._mjPRIVATE__get_xml_precision
    before = getter()
    setter(_FULL_DIGITS)
    try:
        yield
    finally:
        setter(before)
