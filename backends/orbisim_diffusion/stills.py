"""Single images of states whose looks are drawn anew each: what StaInf is trained on.

A file of episodes shows each cube in a hundred images. A network that reads sizes and colours off
some hundred episodes remembers their cubes instead (docs/trainings.md): on the episodes that it was
trained on its colours were right to 0.008, on others to 0.13. Here no two images have a cube in
common.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.cameras import read_camera
from orbisim.errors import InputError
from orbisim.files.writing import writing
from orbisim.registry import make_renderer
from orbisim.scene import visible
from orbisim.state import State
from orbisim.tasks.armtask import ArmTask
from orbisim.tasks.registry import make
from orbisim.tasks.sampling import episode_seed, stream
from orbisim.tasks.tabletop import SETTLED, TABLE_HIGH, TABLE_LOW
from orbisim_diffusion.solids import ABSENT
from orbisim_diffusion.store import Store

Arrays = dict[str, npt.NDArray[Any]]
Floats = npt.NDArray[np.float64]

SUFFIX = ".stills.npz"
_DRAW = 8
"""Number of the random stream of what is drawn anew; scene, policy and camera have others."""
_MOST = 8
"""Geoms of four cubes beside those of arm and table, and room: rows of every file are alike."""
_ELSEWHERE, _JITTERED, _SPUN = 0.5, 0.5, 0.3
"""Probabilities that a cube is put elsewhere on the table, that the arm's joints are moved at
random, and that its last one is turned to anywhere."""
_JITTER = 0.12
"""Standard deviation of moved joints, rad: the hand goes some 10 cm."""
_DEPTH = 3e-3
"""Bodies within each other by more, m, are not shown; tasks stay below 1 mm."""
_TRIES = 6
"""Drawn so often until nothing is within anything; else the episode's own state is shown."""
_LYING = 2e-3
"""A cube whose centre is so near to its half size above the table, m, lies on it."""


def make_stills(
    task: str,
    subtask: str,
    seed: int,
    number: int,
    path: Path,
    camera: str = "side",
    size: int = 128,
) -> int:
    """Runs one episode of an arm's task and writes an image of each of its states, drawn anew.

    Colours are new in every image, and sizes of cubes that lie on the table; cubes are elsewhere
    and joints moved in some (`_ELSEWHERE`, `_JITTERED`, `_SPUN`).

    Args:
      task: `push`, `push_cubes`, ... subtask: of it. seed, number: of the collection and in it.
      path: of the file, which ends in `.stills.npz`. camera: of the scene. size: pixels.

    Returns:
      The number of images.

    Raises:
      InputError: the task has no arm.
    """
    made = make(task)
    if not isinstance(made, ArmTask):
        raise InputError(f"stills are drawn of tasks with an arm; {task!r} has none")
    one = episode_seed(seed, made.label, subtask, number)
    scene, episode = made.scene(subtask, one), made.episode(subtask, one)
    painter = _Painter(made, scene, episode.arrays["qpos"], stream(one, _DRAW), camera, size)
    shots = [painter.shot(t) for t in range(len(episode.arrays["qpos"]))]
    painter.close()
    arrays = {name: np.stack([shot[name] for shot in shots]) for name in shots[0]}
    arrays["lights"] = visible.lights(scene.model).astype(np.float32)
    with writing(path, announce=False) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    return len(shots)


class _Painter:
    """Draws states of one episode anew.

    Args:
      task: its ranges. scene: whose model is changed. qpos: [T, nq] of the episode.
      rng: of all that is drawn. camera, size: of the images.
    """

    def __init__(
        self,
        task: ArmTask,
        scene: Any,
        qpos: Floats,
        rng: np.random.Generator,
        camera: str,
        size: int,
    ) -> None:
        self.model, self.qpos, self.rng, self.size = scene.model, qpos, rng, size
        self.task, self.camera = task, int(scene.model.camera(camera).id)
        self.renderer, self.data = make_renderer("mujoco", scene), mujoco.MjData(scene.model)
        self.shown = visible.seen(self.model)
        self.site = int(self.model.site(task.arm.site).id)
        free = self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
        self.cubes = [int(self.model.body_geomadr[b]) for b in self.model.jnt_bodyid[free]]
        self.bounds = self.model.body_bvhadr[self.model.jnt_bodyid[free]]
        self.places = self.model.jnt_qposadr[free].astype(int)
        self.scalar = self.model.jnt_qposadr[
            self.model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
        ]
        self.sizes = self.model.geom_size[self.cubes].copy()

    def close(self) -> None:
        """Frees the OpenGL context."""
        self.renderer.close()

    def shot(self, t: int) -> Arrays:
        """One image of the state number t, with what it shows."""
        qpos = self._state(t)
        self.model.geom_rgba[self.cubes, :3] = self.rng.uniform(0.1, 0.9, (len(self.cubes), 3))
        state = State(np.zeros(1), qpos[None], np.zeros((1, self.model.nv)), np.zeros((1, 0)))
        image = self.renderer.render(state, camera=self.camera, height=self.size, width=self.size)
        data = self._at(qpos)
        view = read_camera(self.model, data, self.camera)
        rows = np.zeros((len(self.shown) + _MOST - len(self.cubes), len(visible.COLUMNS)))
        rows[:, visible.COLUMNS.index("entity")] = ABSENT
        rows[: len(self.shown)] = visible.rows(self.model)
        pos, quat = np.zeros((len(rows), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
        pos[: len(self.shown)] = data.geom_xpos[self.shown]
        for i, geom in enumerate(self.shown):
            mujoco.mju_mat2Quat(quat[i], data.geom_xmat[geom])
        hand = np.zeros(4)
        mujoco.mju_mat2Quat(hand, data.site_xmat[self.site])
        found = {
            "geoms": rows,
            "pos": pos,
            "quat": quat,
            "view_pos": view.pos,
            "view_rot": view.rot,
            "lens": np.array([*view.focal, *view.offset]),
            "robot/qpos": qpos[self.scalar],
            "robot/pos": data.site_xpos[self.site].copy(),
            "robot/quat": hand,
        }
        return {"frames": image, **{n: np.asarray(v, np.float32) for n, v in found.items()}}

    def _state(self, t: int) -> Floats:
        """Coordinates near those of the episode, and new sizes, with nothing within anything."""
        for _ in range(_TRIES):
            qpos = self.qpos[t].copy()
            self._move_arm(qpos)
            self._move_cubes(qpos)
            if not self._overlaps(qpos):
                return qpos
        self.model.geom_size[self.cubes] = self.sizes
        return self.qpos[t].copy()

    def _move_arm(self, qpos: Floats) -> None:
        joints = self.task.arm.joints
        if self.rng.random() < _JITTERED:
            qpos[:joints] += _JITTER * self.rng.standard_normal(joints)
        if self.rng.random() < _SPUN:
            qpos[joints - 1] = self.rng.uniform(-np.pi, np.pi)

    def _move_cubes(self, qpos: Floats) -> None:
        config = self.task.config
        for cube, place, size in zip(self.cubes, self.places, self.sizes, strict=True):
            self.model.geom_size[cube] = size
            if abs(qpos[place + 2] - size[2]) > _LYING:  # it is held, tilted, or on another one
                continue
            half = self.rng.uniform(*config.cube_half)
            self.model.geom_size[cube] = half * size / size[0]
            qpos[place + 2] = self.model.geom_size[cube, 2] - SETTLED
            if self.rng.random() < _ELSEWHERE:
                margin = 2.0 * half
                qpos[place : place + 2] = self.rng.uniform(TABLE_LOW + margin, TABLE_HIGH - margin)
                yaw = self.rng.uniform(-np.pi, np.pi)
                qpos[place + 3 : place + 7] = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]

    def _overlaps(self, qpos: Floats) -> bool:
        """Whether something is within something else."""
        sizes = self.model.geom_size[self.cubes]
        # what MuJoCo compiled of the sizes, to tell what is far apart
        self.model.geom_rbound[self.cubes] = np.linalg.norm(sizes, axis=1)
        self.model.geom_aabb[self.cubes, 3:] = sizes
        self.model.bvh_aabb[self.bounds, 3:] = sizes
        data = self._at(qpos)
        mujoco.mj_collision(self.model, data)
        return bool(data.ncon) and float(data.contact.dist.min()) < -_DEPTH

    def _at(self, qpos: Floats) -> mujoco.MjData:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        return self.data


def load_stills(paths: Sequence[Path], device: torch.device) -> Store:
    """Files of stills as a store in which each image is an episode of its own.

    Raises:
      InputError: a file is damaged or holds other images than the first.
    """
    parts = [_read(path) for path in paths]
    shape, most = parts[0]["frames"].shape[1:], max(p["geoms"].shape[1] for p in parts)
    lights = parts[0]["lights"]
    for path, part in zip(paths, parts, strict=True):
        if part["frames"].shape[1:] != shape or part["lights"].shape != lights.shape:
            raise InputError(
                f"{path}: images of {part['frames'].shape[1:]} under {len(part['lights'])} lights "
                f"among others of {shape} under {len(lights)}; train on one kind"
            )

    def joined(name: str) -> Tensor:
        return torch.cat([torch.from_numpy(part[name]) for part in parts]).to(device)

    def padded(name: str, column: int, filler: float) -> Tensor:
        rows = []
        for part in parts:
            more = np.zeros((len(part[name]), most, part[name].shape[2]), np.float32)
            more[..., column] = filler
            more[:, : part[name].shape[1]] = part[name]
            rows.append(torch.from_numpy(more))
        return torch.cat(rows).to(device)

    count = sum(len(part["frames"]) for part in parts)
    each = torch.arange(count, device=device)
    light = torch.cat(
        [torch.from_numpy(p["lights"]).expand(len(p["frames"]), -1, -1) for p in parts]
    )
    extras = {
        name: [torch.from_numpy(part[name]).to(device) for part in parts]
        for name in ("robot/qpos", "robot/pos", "robot/quat")
    }
    return Store(
        frames=joined("frames"),
        episode=each,
        first=each,
        length=torch.ones_like(each),
        task=torch.zeros_like(each),
        geoms=padded("geoms", visible.COLUMNS.index("entity"), ABSENT),
        pos=padded("pos", 0, 0.0),
        quat=padded("quat", 0, 1.0),
        view_pos=joined("view_pos"),
        view_rot=joined("view_rot"),
        lens=joined("lens"),
        lights=light.to(device),
        extras=extras,
    )


_NAMES = {
    *("frames", "geoms", "pos", "quat", "view_pos", "view_rot", "lens", "lights"),
    *("robot/qpos", "robot/pos", "robot/quat"),
}


def _read(path: Path) -> Arrays:
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read as stills ({error})") from None
    if missing := sorted(_NAMES - found.keys()):
        raise InputError(f"{path}: is no file of stills: it has no {missing[0]!r}")
    return found
