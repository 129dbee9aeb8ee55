"""What a checkpoint was trained to show: which scenes, from which cameras."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from orbisim.cameras import Camera
from orbisim.errors import InputError
from orbisim.scene import visible
from orbisim_diffusion.solids import ABSENT
from orbisim_diffusion.store import Store

Floats = npt.NDArray[np.float64]
_SAME = 2e-3
"""Sizes (m) and colours that differ by less are the same."""
_PLACE, _TURN = 0.01, 0.02
"""A camera that is farther off, m and in entries of its rotation, is another camera."""
_MANY = 8
"""A set of recordings with more cameras than this has random ones."""


@dataclasses.dataclass(frozen=True)
class SceneScope:
    """Scenes of one kind.

    Attributes:
      fixed: rows (type, size 3, colour 3) of static geoms and of the robot's, in order.
      types: of the objects' geoms. low, high: [3] their sizes, m. count: fewest and most objects.
    """

    fixed: tuple[tuple[float, ...], ...]
    types: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    count: tuple[int, int]


@dataclasses.dataclass(frozen=True)
class ViewScope:
    """A camera, or any.

    Attributes:
      pos: [3], m. rot: [9] by rows. focal: [2]. anywhere: whether training drew cameras at random;
        the others then say nothing.
    """

    pos: tuple[float, ...]
    rot: tuple[float, ...]
    focal: tuple[float, ...]
    anywhere: bool = False


@dataclasses.dataclass(frozen=True)
class Scope:
    """Scenes and cameras of the training data."""

    scenes: tuple[SceneScope, ...]
    views: tuple[ViewScope, ...]


_LENGTHS = {"pos": 3, "rot": 9, "focal": 2, "low": 3, "high": 3}
_ROW = 7
"""Numbers of a row of `SceneScope.fixed`."""


def check_scope(scope: Scope, where: str) -> None:
    """Raises `InputError` if lists of a scope from a file have other lengths than they must."""
    for part in (*scope.scenes, *scope.views):
        wrong = [n for n, m in _LENGTHS.items() if len(getattr(part, n, range(m))) != m]
        if wrong:
            raise InputError(f"{where}: {wrong[0]}: expected {_LENGTHS[wrong[0]]} numbers")
    if any(len(row) != _ROW for scene in scope.scenes for row in scene.fixed):
        raise InputError(f"{where}: fixed: expected rows of {_ROW} numbers")


def read_scope(store: Store) -> Scope:
    """The scope of a store."""
    scenes: dict[tuple[Any, ...], list[Floats]] = {}
    for rows in store.geoms.cpu().numpy():
        rows = rows[rows[:, 7] != ABSENT].astype(np.float64)
        scenes.setdefault(_fixed(rows), []).append(rows[rows[:, 7] > visible.ROBOT])
    return Scope(tuple(_scene(fixed, objects) for fixed, objects in scenes.items()), _views(store))


def _fixed(rows: Floats) -> tuple[tuple[float, ...], ...]:
    """Type, sizes and colours of what is no object, rounded such that equal scenes are equal."""
    return tuple(
        tuple(float(v) for v in row[:7].round(3)) for row in rows if row[7] <= visible.ROBOT
    )


def _scene(fixed: tuple[tuple[float, ...], ...], objects: list[Floats]) -> SceneScope:
    every = np.concatenate(objects)
    none = not len(every)
    return SceneScope(
        fixed=fixed,
        types=tuple(sorted({int(kind) for kind in every[:, 0]})),
        low=(0.0,) * 3 if none else tuple(every[:, 1:4].min(0).tolist()),
        high=(0.0,) * 3 if none else tuple(every[:, 1:4].max(0).tolist()),
        count=(min(map(len, objects)), max(map(len, objects))),
    )


def _views(store: Store) -> tuple[ViewScope, ...]:
    """Cameras of the episodes' first frames; `anywhere` if there are many."""
    lens = store.lens[:, :2]
    rows = torch.cat([store.view_pos[store.first], store.view_rot[store.first].flatten(1), lens], 1)
    found = np.unique(rows.cpu().numpy().astype(np.float64).round(4), axis=0)
    if len(found) > _MANY:
        kept, times = np.unique(
            rows.cpu().numpy().astype(np.float64).round(4), axis=0, return_counts=True
        )
        often = kept[times > 1]
        anywhere = ViewScope((0.0,) * 3, (0.0,) * 9, (0.0,) * 2, anywhere=True)
        return (*(_view(row) for row in often[:_MANY]), anywhere)
    return tuple(_view(row) for row in found)


def _view(row: Floats) -> ViewScope:
    values = tuple(float(v) for v in row)
    return ViewScope(values[:3], values[3:12], values[12:14])


def scene_problem(scope: Scope, rows: Floats) -> str:
    """Why a scene with these rows (`visible.rows`) is none that the checkpoint can show.

    Empty if it can; of several reasons, that of the scene most like it.
    """
    reasons = [_reason(scene, rows) for scene in scope.scenes]
    if not reasons or "" in reasons:
        return "" if reasons else "the checkpoint names no scene"
    return min(reasons, key=len)


def _reason(scene: SceneScope, rows: Floats) -> str:
    fixed = np.array(scene.fixed).reshape(-1, 7)
    ours = np.array(_fixed(rows)).reshape(-1, 7)
    objects = rows[rows[:, 7] > visible.ROBOT]
    if fixed.shape != ours.shape:
        return (
            f"it has {len(ours)} geoms that are no objects; the checkpoint was trained on scenes "
            f"with {len(fixed)}"
        )
    apart = np.abs(fixed - ours).max(1)
    if apart.max(initial=0.0) > _SAME:
        number = int(np.argmax(apart))
        return f"its geom {number} has another type, size or colour than in training"
    strange = set(objects[:, 0].astype(int)) - set(scene.types)
    if strange:
        return f"it has objects of geom type {min(strange)}; training had {list(scene.types)}"
    return ""


def scene_concerns(scope: Scope, rows: Floats) -> list[str]:
    """What lies outside the training data, though it can be shown."""
    fitting = [scene for scene in scope.scenes if not _reason(scene, rows)]
    if not fitting:
        return []
    scene, objects = fitting[0], rows[rows[:, 7] > visible.ROBOT]
    concerns = []
    low, high = (
        min(s.count[0] for s in fitting),
        max(s.count[1] for s in fitting),
    )
    if not low <= len(objects) <= high:
        concerns.append(f"{len(objects)} objects; trained on {low} to {high}")
    for axis in range(3 if len(objects) else 0):
        least, most = objects[:, 1 + axis].min(), objects[:, 1 + axis].max()
        if least < scene.low[axis] - _SAME or most > scene.high[axis] + _SAME:
            concerns.append(
                f"objects of half size {least:.3g} to {most:.3g} m along {'xyz'[axis]}; trained "
                f"on {scene.low[axis]:.3g} to {scene.high[axis]:.3g}"
            )
    return concerns


def view_problem(scope: Scope, camera: Camera) -> str:
    """Why a camera is none that the checkpoint was trained for; empty if it is."""
    fixed = [view for view in scope.views if not view.anywhere]
    if len(fixed) < len(scope.views) or not scope.views:
        return ""
    distances = []
    for view in fixed:
        place = float(np.linalg.norm(camera.pos - np.array(view.pos)))
        turn = float(np.abs(camera.rot.ravel() - np.array(view.rot)).max())
        zoom = abs(camera.focal[1] - view.focal[1])
        if place < _PLACE and turn < _TURN and zoom < _TURN:
            return ""
        distances.append(place)
    return (
        f"the camera stands {min(distances):.2g} m from the nearest one of training, or looks "
        "elsewhere; train with random cameras, or use that one"
    )
