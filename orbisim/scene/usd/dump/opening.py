"""Opens a stage, and refuses what cannot be trusted or is not all there."""

from __future__ import annotations

import os
import posixpath
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd  # type: ignore[import-untyped,unused-ignore]

from orbisim.errors import SceneError

Grow = Callable[[int], None]
"""Called with the bytes of each further file before it is parsed."""

_MAX_LAYERS = 10_000
"""Files of one stage: the largest public ones have some hundreds."""


def open_stage(path: str, grow: Grow, root: str | None = None) -> Any:
    """Opens a stage with all payloads and the default variants.

    Args:
      path: `.usd`, `.usda`, `.usdc` or `.usdz`.
      grow: see `Grow`; the file itself counts as known.
      root: folder that the scene may not refer out of, if its references are confined.

    Raises:
      SceneError: the file or one that it refers to cannot be read, references form a cycle, or
        an archive refers to a file outside of itself.
    """
    if path.lower().endswith(".usdz"):
        check_archive(path)
    fence = _Fence(path, root)
    try:
        visited = _visit_layers(path, fence, grow)  # keeps them from being parsed twice
        stage = Usd.Stage.Open(path, Usd.Stage.LoadAll)
    except Tf.ErrorException as error:
        raise SceneError(path, reason(str(error)), remedy="repair or re-export it") from None
    for layer in stage.GetUsedLayers():
        if not layer.anonymous:
            fence.check_used(layer.realPath or layer.identifier)
    _check_composition(path, stage)
    del visited
    return stage


def check_archive(path: str) -> None:
    """Raises `SceneError` unless a `.usdz` is a plain archive: stored files, relative names.

    A compressed entry could expand without bound; the format forbids compression.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError) as error:
        raise SceneError(path, f"is not a zip archive ({error})") from None
    if not entries:
        raise SceneError(path, "the archive is empty")
    total = Path(path).stat().st_size
    for entry in entries:
        if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > total:
            raise SceneError(
                path,
                f"the entry is compressed ({entry.compress_size} bytes that would become "
                f"{entry.file_size}); a .usdz archive stores files uncompressed",
                element=entry.filename,
                remedy="pack it with usdzip",
            )
        if _leaves(entry.filename):
            raise SceneError(path, "the entry's name leaves the archive", element=entry.filename)


class _Fence:
    """Keeps the references of an archive, or of a confined scene, from leading out of it."""

    def __init__(self, path: str, root: str | None) -> None:
        self._path = path
        self._root = Path(root).resolve() if root else None
        self._archive = path.lower().endswith(".usdz")

    def check(self, layer: Any, asset: str) -> None:
        """Raises if an asset path written in a layer leads out."""
        inner = _entry_of(layer.identifier)
        if inner:
            inside = not _leaves(asset) and not _leaves(
                posixpath.join(posixpath.dirname(inner), asset)
            )
        elif self._root is not None:
            folder = Path(layer.realPath).resolve().parent
            target = Path(os.path.normpath(folder / asset.replace("\\", "/")))
            inside = not _is_absolute(asset) and self._holds(target)
        else:
            return
        if not inside:
            raise SceneError(
                self._path,
                f"refers to @{asset}@, which is outside of the archive",
                element=inner or None,
                remedy="pack the file into the archive and refer to it by a relative path",
            )

    def check_used(self, layer_path: str) -> None:
        """Raises if a layer that composition used lies outside."""
        file = Path(layer_path.partition("[")[0])
        outside = self._archive and file.resolve() != Path(self._path).resolve()
        if outside or not self._holds(file):
            raise SceneError(self._path, f"uses {str(file)!r}, which is outside of the archive")

    def _holds(self, path: Path) -> bool:
        return self._root is None or path.resolve().is_relative_to(self._root)


def _entry_of(identifier: str) -> str:
    """The name inside its archive of a layer that comes from one, or ""."""
    if identifier.endswith("]"):
        return identifier.rpartition("[")[2][:-1]
    if identifier.lower().endswith(".usdz"):  # stands for the first entry
        with zipfile.ZipFile(identifier) as archive:
            return archive.namelist()[0]
    return ""


def _visit_layers(path: str, fence: _Fence, grow: Grow) -> list[Any]:
    """Parses the layers reachable from a file, growing the limits before each."""
    root = Sdf.Layer.FindOrOpen(path)
    layers, seen, queue = [root], {path}, [root]
    while queue and len(layers) < _MAX_LAYERS:
        layer = queue.pop()
        for asset in filter(None, layer.GetCompositionAssetDependencies() if layer else ()):
            fence.check(layer, asset)
            identifier = Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
            if identifier in seen:
                continue
            seen.add(identifier)
            found = _open_dependency(identifier, grow)
            layers.append(found)
            queue.append(found)
    return layers


def _open_dependency(identifier: str, grow: Grow) -> Any:
    """A layer, or None: composition decides whether it is needed."""
    file = Path(identifier.partition("[")[0])
    if file.is_file():
        grow(file.stat().st_size)
        if identifier.lower().endswith(".usdz"):
            check_archive(str(file))
    try:
        return Sdf.Layer.FindOrOpen(identifier)
    except Tf.ErrorException:
        return None


def _is_absolute(name: str) -> bool:
    """Whether a path names a place of its own: a root, a home, a drive or a protocol."""
    return name.startswith(("/", "\\", "~")) or ":" in name.partition("/")[0]


def _leaves(name: str) -> bool:
    """Whether a path inside an archive points out of it."""
    name = name.replace("\\", "/")
    return _is_absolute(name) or posixpath.normpath(name).startswith("..")


def _check_composition(path: str, stage: Any) -> None:
    """Raises for the first arc that does not lead anywhere, or leads in a circle."""
    for error in stage.GetCompositionErrors():
        kind = type(error).__name__
        if kind not in _FATAL:
            continue
        text = re.sub(r",@anon:[^@]*@", "", " ".join(str(error).split()))
        where = re.search(r"introduced by @[^@]*@<([^>]*)>", text)
        where = where or re.search(r"<(/[^>]*)>", text)
        problem, remedy = _FATAL[kind]
        asset = re.search(r"@([^@]+)@", text) if "{asset}" in problem else None
        raise SceneError(
            path,
            problem.format(asset=asset[1] if asset else "a layer", text=text[:300]),
            element=where[1] if where else None,
            remedy=remedy,
        )


_MISSING = ("refers to {asset}, which cannot be read", "restore the file or remove the reference")
_FATAL = {
    "ErrorInvalidAssetPath": _MISSING,
    "ErrorMutedAssetPath": _MISSING,
    "ErrorInvalidSublayerPath": _MISSING,
    "ErrorSublayerCycle": ("its layers include each other in a circle: {text}", None),
    "ErrorArcCycle": ("its references form a circle: {text}", "remove one of them"),
    "ErrorUnresolvedPrimPath": ("a reference leads to no prim: {text}", "correct the prim path"),
    "ErrorCapacityExceeded": ("its composition is too large: {text}", None),
}
"""Composition errors after which part of the scene would be missing, and what to say."""


def reason(text: str) -> str:
    """The essence of OpenUSD's error report: the message of its first error."""
    messages = re.findall(r" : '(.*?)'\s*(?=Error in|$)", " ".join(text.split()))
    first = messages[0] if messages else " ".join(text.split())
    if first.startswith("Failed to open layer"):
        first = "the file is not in any USD format"
    return f"OpenUSD cannot read it: {first[:300].strip()}"
