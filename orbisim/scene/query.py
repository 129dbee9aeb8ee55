"""Options of a reader behind a scene's path: `robot.urdf?actuators=position&package.arm=/opt/arm`.

So a scene with its options is one name, wherever a scene is named by a text: in the command line,
in collections, in reports.
"""

from __future__ import annotations

import urllib.parse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbisim.errors import InputError

MARK = "?"
_PACKAGE = "package."
_WORDS: Mapping[str, Any] = {"true": True, "false": False, "none": None}


def with_options(path: str, options: Mapping[str, Any]) -> str:
    """The name of a scene that is read with options; `package_paths` is a mapping by name."""
    pairs = []
    for name, value in options.items():
        if name == "package_paths":
            pairs += [(f"{_PACKAGE}{package}", str(folder)) for package, folder in value.items()]
        else:
            known = [word for word, meaning in _WORDS.items() if meaning is value]
            pairs.append((name, known[0] if known else str(value)))
    return f"{path}{MARK}{urllib.parse.urlencode(pairs)}" if pairs else path


def without_options(text: str) -> tuple[str, dict[str, Any]]:
    """The path, and the options behind it.

    Raises:
      InputError: what follows the question mark are no options.
    """
    path, mark, query = text.partition(MARK)
    if not mark or Path(text).exists():
        return text, {}
    options: dict[str, Any] = {}
    try:
        pairs = urllib.parse.parse_qsl(query, strict_parsing=True)
    except ValueError:
        raise InputError(
            f"{text!r:.200}: behind {MARK} stand options of the reader, such as "
            "?actuators=position&floating_base=true"
        ) from None
    for name, value in pairs:
        if name.startswith(_PACKAGE):
            options.setdefault("package_paths", {})[name.removeprefix(_PACKAGE)] = value
        else:
            options[name] = _value(value)
    return path, options


def _value(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    try:
        return float(text)
    except ValueError:
        return text
