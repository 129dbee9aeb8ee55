"""One episode of an HDF5 file as rows of a layout, checked on the way."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.files.reading import Allowance
from orbisim.tasks.dataset import EpisodeFile
from orbisim_world_model.layout import Layout
from orbisim_world_model.reading import ATTRIBUTES

Floats = npt.NDArray[Any]

RUNNING = ("qpos", "qvel", "act", "ctrl", "action")
STATIC = ("attributes", "world", "mask")


@dataclasses.dataclass(frozen=True)
class EpisodeRows:
    """An episode of T control steps as a pack holds it.

    Attributes:
      running: [T+1, ...] by the names `RUNNING`; controls after the last state are zero.
      static: by the names `STATIC`.
      steps: T.
    """

    running: dict[str, Floats]
    static: dict[str, Floats]
    steps: int


def read_rows(
    file: EpisodeFile, index: int, layout: Layout, entities: Sequence[str], allowance: Allowance
) -> EpisodeRows:
    """The rows of one episode.

    Args:
      file: of the episodes.
      index: which one.
      layout: of all of them.
      entities: names of the objects of this one.
      allowance: what its arrays are counted against, as they stand and as they are padded.

    Raises:
      InputError: an array is missing, or has another shape than the layout calls for.
    """
    described = ("descriptor/objects",) if layout.objects else ()
    data = file.episode(index, (*RUNNING, "descriptor/world", *described), allowance)
    where = f"{file.path}: episode {index}"
    _check(data, layout, entities, where)
    steps = len(data["ctrl"])
    allowance.take(8 * (steps + 1) * (layout.nq + layout.nv), f"episode {index}, padded,")
    present = np.array([name in entities for name in layout.objects], bool)
    data["qpos"], data["qvel"] = _spread(data, layout, present, where)
    columns = file.columns("descriptor/objects", index) if layout.objects else ()
    static = {
        "attributes": _attributes(data, entities, layout, columns, where),
        "world": data["descriptor/world"],
        "mask": present.astype(float),
    }
    return EpisodeRows({name: _with_last(data[name], steps + 1) for name in RUNNING}, static, steps)


def _check(data: dict[str, Floats], layout: Layout, entities: Sequence[str], where: str) -> None:
    """Raises `InputError` if an array has another shape than the layout calls for."""
    widths: dict[str, int | None] = dict.fromkeys(RUNNING)
    widths |= {"act": layout.na, "ctrl": layout.nu}
    for name, width in widths.items():
        array = data[name]
        if array.dtype.kind not in "biuf" or array.ndim != 2 or width not in (None, array.shape[1]):
            expected = "a number" if width is None else f"{width} numbers"
            raise InputError(
                f"{where}: {name} holds {array.dtype} of shape {array.shape}; expected rows of "
                f"{expected}"
            )
    world = data["descriptor/world"]
    if world.dtype.kind not in "biuf" or world.shape != (len(layout.settings),):
        raise InputError(f"{where}: descriptor/world is not {len(layout.settings)} numbers")
    if not len(data["ctrl"]):
        raise InputError(f"{where}: has no control steps")
    if len(set(entities)) != len(entities):
        raise InputError(f"{where}: two of its entities have the same name")


def _spread(
    data: dict[str, Floats], layout: Layout, present: npt.NDArray[np.bool_], where: str
) -> tuple[Floats, Floats]:
    """qpos [T+1, nq] and qvel [T+1, nv] of an episode, with objects at rest where it has none.

    The episode's scene has its bodies in the layout's order.
    """
    missing = np.flatnonzero(~present)
    qpos, qvel = data["qpos"], data["qvel"]
    sizes = (qpos.shape[1] + 7 * len(missing), qvel.shape[1] + 6 * len(missing))
    if sizes != (layout.nq, layout.nv):
        raise InputError(
            f"{where} has {qpos.shape[1]} coordinates, {qvel.shape[1]} velocities and "
            f"{int(present.sum())} of the {len(layout.objects)} objects {layout.objects[:8]}; "
            f"expected {layout.nq - 7 * len(missing)} and {layout.nv - 6 * len(missing)}"
        )
    if not len(missing):
        return qpos, qvel
    absent_q = (np.asarray(layout.object_q)[missing, None] + np.arange(7)).ravel()
    absent_v = (np.asarray(layout.object_v)[missing, None] + np.arange(6)).ravel()
    whole_q, whole_v = np.zeros((len(qpos), layout.nq)), np.zeros((len(qvel), layout.nv))
    whole_q[:, np.setdiff1d(np.arange(layout.nq), absent_q)] = qpos
    whole_v[:, np.setdiff1d(np.arange(layout.nv), absent_v)] = qvel
    whole_q[:, absent_q[3::7]] = 1.0  # w of the quaternion
    return whole_q, whole_v


def _attributes(
    data: dict[str, Floats],
    entities: Sequence[str],
    layout: Layout,
    columns: Sequence[str],
    where: str,
) -> Floats:
    """[N, D]: rows of the layout's objects among an episode's entities; zeros for absent ones."""
    if not layout.objects:
        return np.zeros((0, 0))
    table = data["descriptor/objects"]
    shape = (len(entities), len(columns))
    lacking = [name for name in ATTRIBUTES if name not in columns]
    if lacking or table.shape != shape or table.dtype.kind not in "biuf":
        lack = f" and no column {lacking[0]!r}" if lacking else ""
        raise InputError(
            f"{where}: descriptor/objects has shape {table.shape}{lack}; expected a row for each "
            f"of {len(entities)} objects"
        )
    chosen = [list(columns).index(name) for name in ATTRIBUTES]
    rows = np.zeros((len(layout.objects), len(ATTRIBUTES)))
    for number, name in enumerate(layout.objects):
        if name in entities:
            rows[number] = table[list(entities).index(name)][chosen]
    return rows


def _with_last(array: Floats, rows: int) -> Floats:
    """With zeros for the controls after the last state."""
    missing = rows - len(array)
    return np.concatenate([array, np.zeros((missing, *array.shape[1:]))]) if missing else array
