"""Makes a `Pack` of episode files (`orbisim collect`); needs MuJoCo for the scene's layout."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from orbisim.errors import InputError
from orbisim.scene import load_scene, named_scene
from orbisim.scene.load import is_scene_name
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make
from orbisim_world_model.baseline import pack_recordings, with_baseline
from orbisim_world_model.episode_rows import RUNNING, STATIC, EpisodeRows, read_rows
from orbisim_world_model.fitting import robot_parameters
from orbisim_world_model.layout import Layout
from orbisim_world_model.pack import Pack, grouped, hands, joined, no_parts
from orbisim_world_model.reading import read_layout
from orbisim_world_model.reading_articulation import limb_rows, read_articulated
from orbisim_world_model.reading_parts import encoder_digest, read_parts
from orbisim_world_model.usable import check_numbers

PACK, EPISODES = ".pack", (".h5", ".hdf5")
"""Suffixes; what has another is a recording."""


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


def limb_groups(packs: Sequence[Pack], scene: str | None = None) -> list[Pack]:
    """Data of robots as a model of limbs sees them (see `with_limbs`), as few packs as possible.

    Args:
      packs: each of one robot.
      scene: of episodes that were collected from a scene's file.
    """
    return grouped([with_limbs(pack, scene) for pack in packs])


def with_limbs(pack: Pack, scene: str | None = None) -> Pack:
    """The episodes of one robot with its limbs as descriptors.

    Args:
      pack: of a task whose episodes all have the same robot.
      scene: see `limb_groups`.

    Raises:
      InputError: it does not say which scene it is of, or has objects.
      UnsupportedSceneError: limbs do not know all of the scene.
    """
    if pack.layout.articulated:
        return pack
    sources = pack.notes["sources"]
    task = str(sources[0].get("task", "")) if sources else ""
    if pack.layout.objects or pack.layout.parts:
        of_task = f" of {task}" if task else ""
        raise InputError(
            f"a model of limbs knows robots alone; the data{of_task} have objects or mechanisms"
        )
    return as_limbs(pack, _nominal(task, task, scene), task)


def as_limbs(pack: Pack, model: mujoco.MjModel, source: str = "") -> Pack:
    """The episodes of a robot of this model with its limbs as descriptors.

    Raises:
      UnsupportedSceneError: limbs do not know all of the scene.
    """
    layout = read_articulated(model, pack.layout.timestep, source=source)
    rows = torch.as_tensor(limb_rows(model, source), dtype=torch.float32)
    row, _ = pack.transitions()
    for name, values in (("unit_q", pack.qpos), ("unit_v", pack.qvel)):
        change = (values[row + 1] - values[row]).square().mean(0).sqrt()
        rows[:, layout.part_columns.index(name)] = change.clamp_min(_LEAST_CHANGE).cpu()
    count = pack.episodes
    return dataclasses.replace(
        pack,
        layout=layout,
        hand=pack.hand[:, :0],
        parts=rows.expand(count, *rows.shape).clone().to(pack.device),
        part_mask=torch.ones(count, len(rows), device=pack.device),
    )


_LEAST_CHANGE = 1e-5
"""rad, m, and a second: least unit of a joint that hardly moves in the data."""


def _read(
    paths: Sequence[str | Path], baseline: str, scene: str | None, timestep: float | None
) -> list[Pack]:
    if not paths:
        raise InputError("no data: give the files that `orbisim collect` wrote, or packs of them")
    packs, recordings = [], []
    for path in map(Path, paths):
        if path.suffix not in (PACK, *EPISODES):
            recordings.append(path)
            continue
        packs.append(Pack.load(path) if path.suffix == PACK else pack_file(path, scene=scene))
        check_numbers(packs[-1], str(path))
    if recordings:
        if scene is None:
            raise InputError("recordings need a scene to be read with: give --scene")
        packs.append(pack_recordings(recordings, scene, timestep))
        check_numbers(packs[-1], ", ".join(map(str, recordings)))
    if baseline == "mujoco":
        packs = [p if p.base.shape[1] else with_baseline(p, scene) for p in packs]
    return packs


def pack_file(path: str | Path, layout: Layout | None = None, scene: str | None = None) -> Pack:
    """The episodes of one HDF5 file.

    Args:
      path: the file.
      layout: of its scene; read from the task's model if None.
      scene: of episodes that were collected from a scene's file. Their own word for it opens none.

    Raises:
      InputError: the file is no collection, or an episode does not fit the task's scene.
    """
    with EpisodeFile(path) as file:
        if not len(file):
            raise InputError(f"{path}: holds no episodes")
        model = _nominal(file.task, str(path), scene)
        nominal = layout or read_layout(model, file.control_timestep, source=file.task)
        if nominal.parts:
            return _pack_parts(file, nominal, model, scene)
        indices = range(len(file))
        entities = [_entities(file, index) if nominal.objects else [] for index in indices]
        layout = _with_all_objects(nominal, entities)
        allowance = file.allowance()
        rows = [read_rows(file, index, layout, entities[index], allowance) for index in indices]
        subtasks = [str(file.attributes(index)["subtask"]) for index in indices]
        source = {"file": Path(path).name, "task": file.task, "seed": file.seed}
    notes = {
        "groups": list(dict.fromkeys(subtasks)),
        "sources": [{**source, "episodes": len(rows)}],
        "robot": robot_parameters(model, nominal),
    }
    return _packed(layout, rows, subtasks, notes, str(path))


def _pack_parts(
    file: EpisodeFile, nominal: Layout, model: mujoco.MjModel, scene: str | None
) -> Pack:
    """Episodes with parts of mechanisms, whose shapes and number differ from scene to scene.

    The scenes are made again from their seeds.
    """
    alike: dict[Layout, list[int]] = {}
    parts, allowance = [], file.allowance()
    for index in range(len(file)):
        made = scene_of(file, index, scene)
        layout = read_layout(made, file.control_timestep, source=file.task)
        parts.append(read_parts(made, layout, file.task))
        alike.setdefault(layout, []).append(index)
    found = []
    for layout, indices in alike.items():
        names = [_entities(file, index) if layout.objects else [] for index in indices]
        rows = [
            read_rows(file, index, layout, there, allowance)
            for index, there in zip(indices, names, strict=True)
        ]
        subtasks = [str(file.attributes(index)["subtask"]) for index in indices]
        source = {"file": file.path.name, "task": file.task, "seed": file.seed}
        notes = {
            "groups": list(dict.fromkeys(subtasks)),
            "sources": [{**source, "episodes": len(rows)}],
            "robot": robot_parameters(model, nominal),
            "shapes": encoder_digest(),
        }
        own = _float(np.array([parts[index] for index in indices]))
        pack = _packed(layout, rows, subtasks, notes, str(file.path))
        mask = torch.ones(len(indices), len(layout.parts))
        found.append(dataclasses.replace(pack, parts=own, part_mask=mask))
    order = [index for indices in alike.values() for index in indices]
    return joined(found).subset(torch.argsort(torch.tensor(order)))


def scene_of(file: EpisodeFile, index: int, scene: str | None = None) -> mujoco.MjModel:
    """The model of an episode.

    Raises:
      InputError: it is not the one that the episode was collected from.
    """
    known = file.attributes(index)
    if is_scene_name(file.task):
        made = make(file.task, **file.config).scene(known["subtask"], known["seed"])
    else:
        made = load_scene(scene or file.task)
    if made.fingerprint != known["scene_hash"]:
        raise InputError(
            f"{file.path}: episode {index} was collected from another scene than this version "
            f"makes of {file.task} and seed {known['seed']}; collect the episodes again"
        )
    return made.model


def _packed(
    layout: Layout,
    rows: Sequence[EpisodeRows],
    subtasks: Sequence[str],
    notes: dict[str, Any],
    path: str,
) -> Pack:
    """Episodes after one another."""
    if len({one.running["action"].shape[1] for one in rows}) > 1:
        raise InputError(f"{path}: its episodes have actions of different widths")
    running = {n: _float(np.concatenate([one.running[n] for one in rows])) for n in RUNNING}
    static = {n: _float(np.array([one.static[n] for one in rows])) for n in STATIC}
    lengths = np.array([one.steps for one in rows])
    ends = np.cumsum(lengths + 1)
    return Pack(
        layout=layout,
        **running,
        **static,
        hand=hands(layout, running["qpos"], running["qvel"]),
        base=torch.zeros(int(ends[-1]), 0),
        start=torch.as_tensor(ends - lengths - 1),
        length=torch.as_tensor(lengths),
        group=torch.as_tensor([notes["groups"].index(name) for name in subtasks]),
        notes=notes,
        **no_parts(len(rows)),
    )


@functools.lru_cache(maxsize=8)
def _nominal(task: str, path: str, scene: str | None = None) -> mujoco.MjModel:
    if scene is None or is_scene_name(task):
        try:
            return named_scene(task, path).model
        except InputError:
            if Path(task).suffix:
                named = task.partition("?")[0]
                raise InputError(
                    f"{path}: its episodes are of the file {named!r:.200}, which is not opened "
                    "because data name it; give the scene with --scene, and the options that it "
                    "was collected with (--actuators)"
                ) from None
            raise
    return load_scene(scene).model


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
