"""Makes a `Pack` of episode files (`orbisim collect`); needs MuJoCo for the scene's layout."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from orbisim.errors import InputError
from orbisim.tasks.dataset import EpisodeFile
from orbisim_world_model.baseline import pack_recordings, with_baseline
from orbisim_world_model.fitting import robot_parameters
from orbisim_world_model.layout import Layout
from orbisim_world_model.pack import Pack, hands, joined
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
    return joined(packs)


def pack_file(path: str | Path, layout: Layout | None = None) -> Pack:
    """The episodes of one HDF5 file.

    Args:
      path: the file.
      layout: of its scene; read from the task's model if None.
    """
    with EpisodeFile(path) as file:
        layout = layout or task_layout(file.task, file.control_timestep)
        names = ("qpos", "qvel", "act", "ctrl", "action")
        columns: dict[str, list[Any]] = {name: [] for name in names}
        static: dict[str, list[Any]] = {"attributes": [], "world": [], "mask": []}
        groups: list[str] = []
        group, lengths = [], []
        for index in range(len(file)):
            data = file.episode(index)
            lengths.append(len(data["ctrl"]))
            for name in names:
                columns[name].append(_with_last(data[name], lengths[-1] + 1))
            static["attributes"].append(_attributes(file, data, index, layout))
            static["world"].append(data["descriptor/world"].reshape(-1))
            static["mask"].append(np.ones(len(layout.objects)))
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
            "robot": robot_parameters(_nominal(source["task"]), layout),
        },
    )


def task_layout(task: str, control_timestep: float) -> Layout:
    """The layout of a task's nominal scene."""
    return read_layout(_nominal(task), control_timestep, source=task)


@functools.lru_cache(maxsize=8)
def _nominal(task: str) -> mujoco.MjModel:
    from orbisim.scene import load_scene

    return load_scene(task).model


def _attributes(file: EpisodeFile, data: dict[str, Any], index: int, layout: Layout) -> Any:
    """[N, D]: rows of the layout's objects among the file's entities."""
    if not layout.objects:
        return np.zeros((0, 0))
    columns = file.columns("descriptor/objects", index)
    entities = [name for name in file.entities(index) if name != "robot"]
    missing = [name for name in layout.objects if name not in entities]
    if missing:
        raise InputError(f"{file.path}: episode {index} has no object {missing[0]!r}")
    rows = [entities.index(name) for name in layout.objects]
    return data["descriptor/objects"][rows][:, [columns.index(name) for name in ATTRIBUTES]]


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
