"""The readers there are, by suffix and by root element."""

from __future__ import annotations

from orbisim import plugins
from orbisim.errors import InputError, MissingDependencyError
from orbisim.scene.reading import Reader

GROUP = "orbisim.readers"

_registered: dict[str, type[Reader]] = {}


def register_reader(suffix: str, reader: type[Reader]) -> None:
    """Registers a reader for this process, without an entry point.

    Args:
      suffix: of its files, with the dot. reader: its class.

    Raises:
      InputError: it is no reader, or the suffix has no dot.
    """
    if not (isinstance(reader, type) and issubclass(reader, Reader)):
        raise InputError(f"{suffix!r} must be a subclass of Reader; got {reader!r}")
    if not suffix.startswith(".") or suffix != suffix.lower():
        raise InputError(f"a suffix is in small letters and starts with a dot; got {suffix!r}")
    _registered[suffix] = reader


def suffixes() -> tuple[str, ...]:
    """The suffixes that have a reader, with their dots."""
    return tuple(dict.fromkeys([*(f".{name}" for name in plugins.names(GROUP)), *_registered]))


def reader_of_suffix(suffix: str) -> Reader:
    """The reader of files that end so.

    Raises:
      UnknownNameError: there is none.
      MissingDependencyError: its packages are not installed.
    """
    if suffix in _registered:
        return _registered[suffix]()
    found: Reader = plugins.load(GROUP, suffix.removeprefix("."), "reader of scenes")()
    return found


def reader_of_root(tag: str) -> Reader | None:
    """The reader of XML documents with this root element; None if there is none installed."""
    for suffix in suffixes():
        try:
            reader = reader_of_suffix(suffix)
        except MissingDependencyError:
            continue
        if tag and reader.root == tag:
            return reader
    return None
