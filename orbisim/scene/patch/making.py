"""From two scenes to a patch that was tried: it is only given if it makes the same model."""

from __future__ import annotations

import dataclasses
import difflib
import os
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from orbisim.errors import SceneError
from orbisim.host.engine_log import engine_warnings, ignore
from orbisim.scene.mjcf import COMPILER_ERRORS
from orbisim.scene.patch.differences import differences
from orbisim.scene.patch.editing import Counterparts, applied, edits
from orbisim.scene.patch.marked import Element, parsed, read
from orbisim.scene.scene import Scene

TOLERANCE = 1e-9
"""Relative; degrees are written for radians, and back."""
_TURNING = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL))


@dataclasses.dataclass(frozen=True)
class Patch:
    """A patch in the unified format, or why there is none.

    Attributes:
      text: apply it with `patch -p1` in `folder`; empty where there is none.
      folder: that the names in it count from; the scene's own, or one above it.
      problem: why there is none; empty where there is one.
    """

    text: str
    folder: Path | None = None
    problem: str = ""


def patch_of(before: Scene, after: Scene) -> Patch:
    """What to change in the files of a scene to make it another one.

    Formatting, comments and includes stay. The changed files are compiled, and there is no patch
    unless the model is that of `after` to a relative difference of `TOLERANCE`.

    Args:
      before: a scene that was read from an MJCF file, which is as it was.
      after: the same with edits of its document.
    """
    path = Path(before.source)
    if path.suffix.lower() not in (".xml", ".mjcf") or not path.is_file():
        return Patch("", problem=f"{before.source} is no MJCF file")
    try:
        files = _changed_files(before, after, path)
        _check(files, path.resolve(), after.model)
    except (SceneError, UnicodeDecodeError, OSError) as error:
        return Patch("", problem=str(error))
    if not files:
        return Patch("", problem="nothing differs")
    folder = Path(os.path.commonpath([path.resolve().parent, *(one.parent for one in files)]))
    text = "".join(_unified(file, folder, *texts) for file, texts in sorted(files.items()))
    where = "the folder" if folder == path.resolve().parent else f"{folder}, above the folder"
    return Patch(f"Apply in {where} of {path.name}: patch -p1 < THIS_FILE\n{text}", folder)


def _changed_files(before: Scene, after: Scene, path: Path) -> dict[Path, tuple[bytes, bytes]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # given when the scene was loaded
        old, new = parsed(before.to_xml()), parsed(after.to_xml())
    own = read(path)
    degrees = True
    for element in own.children:
        if element.tag == "compiler":
            degrees = element.attributes.get("angle", "degree" if degrees else "radian") == "degree"
    found = edits(
        differences(old, new), Counterparts(old, own), _turning(new, after.model), degrees
    )
    return applied(found)


def _turning(document: Element, model: mujoco.MjModel) -> frozenset[int]:
    """The joints that turn: joints of a model stand in the order of the document."""
    worlds = [one for one in document.children if one.tag == "worldbody"]
    joints = [
        one for world in worlds for one in world.descendants() if one.tag in ("joint", "freejoint")
    ]
    if len(joints) != model.njnt:
        raise SceneError("", f"{len(joints)} joints are written, the model has {model.njnt}")
    return frozenset(
        id(one) for one, kind in zip(joints, model.jnt_type, strict=True) if kind in _TURNING
    )


def _check(files: dict[Path, tuple[bytes, bytes]], path: Path, wanted: mujoco.MjModel) -> None:
    """Raises `SceneError` unless the changed files give the wanted model."""
    main = path if path.suffix == ".xml" else path.with_name(f"{path.name}.xml")
    with mujoco.MjVfs() as changed, engine_warnings(ignore), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # given when the scene was loaded
        for file, (_, data) in files.items():
            changed[str(main if file == path else file)] = data
        if main != path and path not in files:
            changed[str(main)] = path.read_bytes()
        try:
            model = mujoco.MjSpec.from_file(str(main), vfs=changed).compile()
        except COMPILER_ERRORS as error:
            raise SceneError("", f"MuJoCo refuses the changed files: {error}") from None
    if field := different(model, wanted):
        raise SceneError("", f"the changed files give another {field}")


def different(model: mujoco.MjModel, other: mujoco.MjModel) -> str:
    """Name of the first field in which two models differ; empty if there is none."""
    for name in _FIELDS:
        values, others = (np.asarray(getattr(one, name)) for one in (model, other))
        if values.shape != others.shape:
            return name
        if values.dtype.kind == "f":
            size = max(1e-12, float(np.abs(others).max(initial=0.0)))
            if not np.allclose(values, others, rtol=TOLERANCE, atol=TOLERANCE * size):
                return name
        elif not np.array_equal(values, others):
            return name
    for name in _options():
        if not np.allclose(getattr(model.opt, name), getattr(other.opt, name), rtol=TOLERANCE):
            return f"option {name}"
    return ""


def _options() -> list[str]:
    option = mujoco.MjOption()
    return [n for n in dir(option) if n[0] != "_" and not callable(getattr(option, n))]


def _array_fields() -> list[str]:
    model: Any = mujoco.MjModel.from_xml_string("<mujoco/>")
    fields = (n for n in dir(model) if n[0] != "_" and not n.startswith(_NOT_PHYSICAL))
    arrays = [n for n in fields if isinstance(getattr(model, n), np.ndarray)]
    return [n for n in arrays if not n.endswith("pathadr")]


_NOT_PHYSICAL = ("names", "paths")
_FIELDS = _array_fields()


def _unified(file: Path, folder: Path, before: bytes, after: bytes) -> str:
    name = file.relative_to(folder).as_posix()
    old, new = (_lines(data.decode()) for data in (before, after))
    lines = difflib.unified_diff(old, new, f"a/{name}", f"b/{name}")
    return "".join(
        line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines
    )


def _lines(text: str) -> list[str]:
    """Lines with their ends; the last one has none if the file ends without."""
    *lines, last = text.split("\n")
    return [*(f"{line}\n" for line in lines), *([last] if last else [])]
