"""What was checked once is not checked again.

A file is known by its content (SHA-256). Within a process the content of a file that looks
untouched (device, inode, size, times of modification and change) is not hashed again. What is known
of a content is also kept in the user's cache folder (`$XDG_CACHE_HOME/orbisim/checked`), one small
file for each: writers replace whole files, so that any number of processes may share it, and a
reader that finds something else than it expects goes on as if nothing were known. The folder is
used only if it belongs to the user and nobody else may write there. `ORBISIM_NO_CACHE=1` turns it
off.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import stat
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

Facts: TypeAlias = Mapping[str, Any]
"""What is known of a content: an object of JSON."""

_VERSION = "1"
"""Of the checks: what an older one let pass is looked at again."""
_MOST = 4096
"""Contents that a process remembers; a robot has some tens of meshes."""
_SETTLED_NS = 50_000_000
"""A file changed less than 50 ms before it was hashed may change again within one time stamp."""
_UNUSED_DAYS = 90
"""After which facts are thrown away: a check takes seconds at most, so that little is lost."""
_SWEEP_EVERY = 500
"""Writes, on average, between two looks through the folder, which takes as long as some writes."""

_Signature: TypeAlias = tuple[int, ...]
_digests: dict[str, tuple[_Signature, str]] = {}
_facts: dict[str, Facts] = {}


def digest_of(path: str | Path) -> str:
    """The hash of a file's content.

    Raises:
      OSError: it cannot be read.
    """
    name = os.fspath(path)
    signature = signature_of(name)
    known = _digests.get(name)
    if known is not None and known[0] == signature:
        return known[1]
    with open(name, "rb") as file:  # noqa: PTH123 (also in a forked child)
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    settled = time.time_ns() - max(signature[-2:]) > _SETTLED_NS
    if settled and signature_of(name) == signature:
        _keep(_digests, name, (signature, digest))
    return digest


def signature_of(path: str | Path) -> _Signature:
    """What changes when a file changes: device, inode, size, times of modification and change."""
    found = os.stat(path)  # noqa: PTH116
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def key_of(kind: str, *parts: str) -> str:
    """The name under which facts are kept."""
    return hashlib.sha256("\0".join((_VERSION, kind, *parts)).encode()).hexdigest()


def recall(key: str) -> Facts | None:
    """The facts kept under a name; None if there are none."""
    if key not in _facts:
        found = _read(key)
        if found is None:
            return None
        _keep(_facts, key, found)
    return _facts[key]


def remember(key: str, facts: Facts) -> None:
    """Keeps facts, in this process and for those to come."""
    _keep(_facts, key, facts)
    _write(key, facts)


def forget_all() -> None:
    """Drops what this process knows; the cache folder stays."""
    _digests.clear()
    _facts.clear()


def _keep(store: dict[str, Any], key: str, value: Any) -> None:
    store[key] = value
    while len(store) > _MOST:
        store.pop(next(iter(store)), None)


# ---- the cache folder --------------------------------------------------------------------------


def cache_folder() -> Path | None:
    """The folder, made if need be; None if there is no safe one."""
    if os.environ.get("ORBISIM_NO_CACHE") or not hasattr(os, "getuid"):
        return None
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    try:
        folder = Path(base).expanduser() / "orbisim" / "checked"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except (OSError, RuntimeError):  # read-only, full, no home
        return None
    mine = found.st_uid == os.getuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return folder if mine else None


def _read(key: str) -> Facts | None:
    folder = cache_folder()
    if folder is None:
        return None
    try:
        found = json.loads((folder / f"{key}.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return found["facts"] if isinstance(found, dict) and found.get("key") == key else None


def _write(key: str, facts: Facts) -> None:
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        descriptor, name = tempfile.mkstemp(dir=folder, prefix=".", suffix=".tmp")
        try:
            with os.fdopen(descriptor, "w") as file:
                json.dump({"key": key, "facts": dict(facts)}, file)
            Path(name).replace(folder / f"{key}.json")
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        if random.randrange(_SWEEP_EVERY) == 0:
            sweep(folder)


def sweep(folder: Path, days: float = _UNUSED_DAYS) -> None:
    """Removes what was written long ago; it is checked again when it is needed."""
    oldest = time.time() - days * 86400
    for entry in folder.iterdir():
        with contextlib.suppress(OSError):
            if entry.stat().st_mtime < oldest:
                entry.unlink()
