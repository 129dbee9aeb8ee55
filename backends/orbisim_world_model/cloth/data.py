"""Episodes of cloths as tensors: what falls, and what stands there."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim.tasks.dataset import EpisodeFile
from orbisim_world_model.cloth.mesh import Cloth, Mesh, read_mesh
from orbisim_world_model.cloth.solids import Solids, joined, read_solids
from orbisim_world_model.packing import scene_of


@dataclasses.dataclass(frozen=True, eq=False)
class Falls:
    """Episodes of one cloth, all equally long.

    Attributes:
      mesh: the cloth. x: [episodes, T + 1, V, 3]. solids: of each episode.
      group: [episodes] number of each one's subtask among `notes["groups"]`.
      notes: where they come from.
    """

    mesh: Mesh
    x: Cloth
    solids: Solids
    group: Tensor
    notes: dict[str, Any]

    @property
    def episodes(self) -> int:
        """How many."""
        return len(self.x.pos)

    @property
    def steps(self) -> int:
        """Of an episode."""
        return self.x.pos.shape[1] - 1

    def subset(self, index: Tensor) -> Falls:
        """Some of the episodes."""
        return dataclasses.replace(
            self, x=self.x.at(index), solids=self.solids.at(index), group=self.group[index]
        )

    def split(self, share: float) -> tuple[Falls, Falls]:
        """The first ones, and a share of each group from its end."""
        held = torch.zeros_like(self.group, dtype=torch.bool)
        for number in range(len(self.notes["groups"])):
            own = torch.nonzero(self.group == number)[:, 0]
            held[own[len(own) - round(share * len(own)) :]] = True
        return self.subset(torch.nonzero(~held)[:, 0]), self.subset(torch.nonzero(held)[:, 0])

    def to(self, device: torch.device | str) -> Falls:
        """On a device."""
        return dataclasses.replace(
            self,
            mesh=self.mesh.to(device),
            x=Cloth(*(field.to(device) for field in self.x)),
            solids=self.solids.to(device),
            group=self.group.to(device),
        )


def read_falls(paths: Sequence[str | Path], scene: str | None = None) -> Falls:
    """The episodes of files that `orbisim collect task:drape` wrote.

    Args:
      paths: the files.
      scene: of episodes that were collected from a scene's file.

    Raises:
      InputError: a file is no collection, was made from other scenes than this version makes, or
        has another cloth or length than those before.
      UnsupportedSceneError: a scene has no cloth that can be learned.
    """
    if not paths:
        raise InputError("no data: give the files that `orbisim collect task:drape` wrote")
    parts = [_read(Path(path), scene) for path in paths]
    first = parts[0]
    for path, other in zip(paths, parts, strict=True):
        if other.steps != first.steps or not _alike(first.mesh, other.mesh):
            raise InputError(f"{path}: has another cloth, or episodes of another length, than "
                             f"{paths[0]}")  # fmt: skip
    names = list(dict.fromkeys(name for part in parts for name in part.notes["groups"]))
    groups = [
        torch.tensor([names.index(name) for name in part.notes["groups"]])[part.group]
        for part in parts
    ]
    return Falls(
        first.mesh,
        Cloth(*(torch.cat(f) for f in zip(*(part.x for part in parts), strict=True))),
        joined([part.solids for part in parts]),
        torch.cat(groups),
        {"groups": names, "sources": [s for part in parts for s in part.notes["sources"]]},
    )


def _read(path: Path, scene: str | None) -> Falls:
    if path.suffix not in (".h5", ".hdf5"):
        raise InputError(f"{path}: a learned cloth is trained on files of `orbisim collect`")
    with EpisodeFile(path) as file:
        if not len(file):
            raise InputError(f"{path}: holds no episodes")
        allowance = file.allowance()
        mesh: Mesh | None = None
        states, solids, subtasks = [], [], []
        for index in range(len(file)):
            model = scene_of(file, index, scene)
            mesh = _mesh_of(model, file, mesh, index)
            data = file.episode(index, ("qpos", "qvel"), allowance)
            states.append(_cloth(mesh, data, f"{path}: episode {index}"))
            solids.append(read_solids(model, file.task))
            subtasks.append(str(file.attributes(index)["subtask"]))
        if len({len(x.pos) for x in states}) > 1:
            raise InputError(f"{path}: its episodes have different lengths")
        assert mesh is not None
        task = f"task:{file.task.removeprefix('task:')}"
        source = {"file": path.name, "task": task, "seed": file.seed, "episodes": len(states)}
    names = list(dict.fromkeys(subtasks))
    return Falls(
        mesh,
        Cloth(*(torch.stack(field) for field in zip(*states, strict=True))),
        joined(solids),
        torch.tensor([names.index(name) for name in subtasks]),
        {"groups": names, "sources": [source]},
    )


def _mesh_of(model: mujoco.MjModel, file: EpisodeFile, known: Mesh | None, index: int) -> Mesh:
    found = read_mesh(model, file.control_timestep, file.task)
    if known is not None and not _alike(known, found):
        raise InputError(f"{file.path}: episode {index} has another cloth than those before")
    return found


def _alike(one: Mesh, other: Mesh) -> bool:
    """Whether two cloths are the same at rest, and step alike."""
    if (one.nq, one.nv, len(one.edge)) != (other.nq, other.nv, len(other.edge)):
        return False
    same = torch.equal(one.edge, other.edge) and torch.equal(one.address, other.address)
    close = torch.allclose(one.rest, other.rest) and torch.allclose(one.mass, other.mass)
    return same and close and abs(one.timestep - other.timestep) < 1e-9


def _cloth(mesh: Mesh, data: dict[str, Any], where: str) -> Cloth:
    qpos, qvel = data["qpos"], data["qvel"]
    if qpos.ndim != 2 or qpos.shape[1] != mesh.nq or qvel.shape != (len(qpos), mesh.nv):
        raise InputError(
            f"{where}: qpos and qvel have shapes {qpos.shape} and {qvel.shape}; expected rows of "
            f"{mesh.nq} and {mesh.nv} numbers"
        )
    if not (np.isfinite(qpos).all() and np.isfinite(qvel).all()):
        raise InputError(f"{where}: has numbers that are not finite")
    return mesh.split(*(torch.as_tensor(np.asarray(a, np.float32)) for a in (qpos, qvel)))
