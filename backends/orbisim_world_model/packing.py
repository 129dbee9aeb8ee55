"""Makes a `Pack` of episode files (`orbisim collect`); needs MuJoCo for the scene's layout."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch

from orbisim.errors import InputError
from orbisim.tasks.dataset import EpisodeFile
from orbisim_world_model.baseline import pack_recordings, with_baseline
from orbisim_world_model.fitting import robot_parameters
from orbisim_world_model.layout import Layout
from orbisim_world_model.pack import Pack, grouped, hands, joined
from orbisim_world_model.reading import ATTRIBUTES, read_layout


def read_data(
    paths: Sequence[str | Path],
    *,
    baseline: str = "none",
    scene: str | None = None,
    timestep: float | None = None,
) -> Pack:
    """Episode files (`.h5`), packs (`.pack`) and recordings, as one pack.

    Args:
      paths: the files.
      baseline: `mujoco` to add what MuJoCo's own step predicts.
      scene: whose step that is; the task's nominal one if None. Recordings need it.
      timestep: control step of recordings, s; their own sampling interval if None.

    Raises:
      InputError: a file cannot be read, or the scenes do not fit into one model.
    """
    return joined(_read(paths, baseline, scene, timestep))


def read_groups(
    paths: Sequence[str | Path],
    *,
    baseline: str = "none",
    scene: str | None = None,
    timestep: float | None = None,
) -> list[Pack]:
    """Like `read_data`, with a pack for each robot that the files have."""
    return grouped(_read(paths, baseline, scene, timestep))


def _read(
    paths: Sequence[str | Path], baseline: str, scene: str | None, timestep: float | None
) -> list[Pack]:
    if not paths:
        raise InputError("no data: give the files that `orbisim collect` wrote, or packs of them")
    packs, recordings = [], []
    for path in map(Path, paths):
        if path.suffix == ".pack":
            packs.append(Pack.load(path))
        elif path.suffix in (".h5", ".hdf5"):
            packs.append(pack_file(path))
        else:
            recordings.append(path)
    if recordings:
        if scene is None:
            raise InputError("recordings need a scene to be read with: give --scene")
        packs.append(pack_recordings(recordings, scene, timestep))
    if baseline == "mujoco":
        packs = [p if p.base.shape[1] else with_baseline(p, scene) for p in packs]
    return packs


def pack_file(path: str | Path, layout: Layout | None = None) -> Pack:
    """The episodes of one HDF5 file.

    Args:
      path: the file.
      layout: of its scene; read from the task's model if None.
    """
    with EpisodeFile(path) as file:
        nominal = layout or task_layout(file.task, file.control_timestep)
        entities = [_entities(file, index) if nominal.objects else [] for index in range(len(file))]
        layout = _with_all_objects(nominal, entities)
        names = ("qpos", "qvel", "act", "ctrl", "action")
        read: tuple[str, ...] = (*names, "descriptor/world")
        chosen: list[int] = []
        if layout.objects:
            read = (*read, "descriptor/objects")
            described = file.columns("descriptor/objects")
            chosen = [described.index(name) for name in ATTRIBUTES]
        columns: dict[str, list[Any]] = {name: [] for name in names}
        static: dict[str, list[Any]] = {"attributes": [], "world": [], "mask": []}
        groups: list[str] = []
        group, lengths = [], []
        for index in range(len(file)):
            data = file.episode(index, read)
            lengths.append(len(data["ctrl"]))
            present = np.array([name in entities[index] for name in layout.objects], bool)
            data["qpos"], data["qvel"] = _spread(file, data, index, layout, present)
            for name in names:
                columns[name].append(_with_last(data[name], lengths[-1] + 1))
            static["attributes"].append(_attributes(data, entities[index], layout, chosen))
            static["world"].append(data["descriptor/world"].reshape(-1))
            static["mask"].append(present.astype(float))
            subtask = file.attributes(index)["subtask"]
            groups += [subtask] if subtask not in groups else []
            group.append(groups.index(subtask))
        source = {"file": Path(path).name, "task": file.task, "seed": file.seed}
    rows = np.asarray(lengths) + 1
    tensors = {name: _float(np.concatenate(parts)) for name, parts in columns.items()}
    return Pack(
        layout=layout,
        **tensors,
        hand=hands(layout, tensors["qpos"], tensors["qvel"]),
        base=torch.zeros(int(rows.sum()), 0),
        start=torch.as_tensor(np.cumsum(rows) - rows),
        length=torch.as_tensor(lengths),
        **{name: _float(np.array(parts)) for name, parts in static.items()},
        group=torch.as_tensor(group),
        notes={
            "groups": groups,
            "sources": [{**source, "episodes": len(lengths)}],
            "robot": robot_parameters(_nominal(source["task"]), nominal),
        },
    )


def task_layout(task: str, control_timestep: float) -> Layout:
    """The layout of a task's nominal scene."""
    return read_layout(_nominal(task), control_timestep, source=task)


@functools.lru_cache(maxsize=8)
def _nominal(task: str) -> mujoco.MjModel:
    from orbisim.scene import load_scene

    return load_scene(task).model


def _with_all_objects(layout: Layout, entities: list[list[str]]) -> Layout:
    """The layout with the objects that some episode has beyond those of the nominal scene."""
    seen = dict.fromkeys(name for names in entities for name in names)
    more = [name for name in seen if name not in layout.objects]
    if not more:
        return layout
    steps = range(len(more))
    return dataclasses.replace(
        layout,
        nq=layout.nq + 7 * len(more),
        nv=layout.nv + 6 * len(more),
        objects=(*layout.objects, *more),
        object_q=(*layout.object_q, *(layout.nq + 7 * i for i in steps)),
        object_v=(*layout.object_v, *(layout.nv + 6 * i for i in steps)),
    )


def _entities(file: EpisodeFile, index: int) -> list[str]:
    return [name for name in file.entities(index) if name != "robot"]


def _spread(
    file: EpisodeFile,
    data: dict[str, Any],
    index: int,
    layout: Layout,
    present: npt.NDArray[np.bool_],
) -> tuple[Any, Any]:
    """qpos [T+1, nq] and qvel [T+1, nv] of an episode, with objects at rest where it has none.

    The episode's scene has its bodies in the layout's order.
    """
    missing = np.flatnonzero(~present)
    qpos, qvel = data["qpos"], data["qvel"]
    sizes = (qpos.shape[1] + 7 * len(missing), qvel.shape[1] + 6 * len(missing))
    if sizes != (layout.nq, layout.nv):
        raise InputError(
            f"{file.path}: episode {index} has {qpos.shape[1]} coordinates and "
            f"{int(present.sum())} of the {len(layout.objects)} objects {layout.objects}; "
            f"expected {layout.nq - 7 * len(missing)} coordinates"
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
    data: dict[str, Any], entities: list[str], layout: Layout, columns: list[int]
) -> Any:
    """[N, D]: rows of the layout's objects among an episode's entities; zeros for absent ones."""
    if not layout.objects:
        return np.zeros((0, 0))
    rows = np.zeros((len(layout.objects), len(ATTRIBUTES)))
    for number, name in enumerate(layout.objects):
        if name in entities:
            rows[number] = data["descriptor/objects"][entities.index(name)][columns]
    return rows


def _with_last(array: Any, rows: int) -> Any:
    """With zeros for the controls after the last state."""
    missing = rows - len(array)
    return np.concatenate([array, np.zeros((missing, *array.shape[1:]))]) if missing else array


def _float(array: Any) -> Any:
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32)


def check_kinematics(model: mujoco.MjModel, layout: Layout, qpos: Any) -> float:
    """Largest distance, m, between MuJoCo's hand and the layout's, over qpos [F, nq]."""
    data, worst = mujoco.MjData(model), 0.0
    ours = hands(layout, torch.as_tensor(qpos), torch.zeros(len(qpos), layout.nv).double())
    for row, hand in zip(qpos, ours, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        there = data.site(layout.hand).xpos
        worst = max(worst, float(np.abs(hand[:3].numpy() - there).max()))
    return worst
