"""Names of a package that are imported when they are first used."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from orbisim.errors import missing_module


def lazy(
    package: str, homes: Mapping[str, str], modules: Sequence[str] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package whose names are found in other modules.

    Args:
      package: its name.
      homes: names and the modules that define them.
      modules: names of its own modules that can be used without importing them.
    """

    def getattribute(name: str) -> Any:
        if name in homes:
            value = getattr(imported(homes[name]), name)
            setattr(sys.modules[package], name, value)
            return value
        if name in modules:
            return imported(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    def imported(module: str) -> Any:
        try:
            return importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name != "dm_control":
                raise
            raise missing_module(module, error, "all") from error

    def directory() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes, *modules})

    return getattribute, directory
