"""Episodes with images, on the device: where training and evaluation take their samples from."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import multiprocessing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.cameras import Camera
from orbisim.errors import InputError
from orbisim.host.progress import track
from orbisim.scene import visible
from orbisim.tasks.dataset import EpisodeFile
from orbisim_diffusion.conditions import (
    CONTROLS,
    Meshes,
    control_tokens,
    geometry_maps,
    heatmaps,
    map_channels,
    object_tokens,
    one_token,
)
from orbisim_diffusion.config import DenoiserConfig
from orbisim_diffusion.own import read_own
from orbisim_diffusion.shapes import PRIMITIVES, Meet, compiled_primitives
from orbisim_diffusion.solids import ABSENT, Lamps, Solids, View, matrices

Arrays = dict[str, npt.NDArray[Any]]
_STEP = 64
"""Views whose rays are cast at a time: 64 views of 18 geoms take 3 GB."""
_FRAMES = "frames/"
_EXTRAS = ("robot/qpos", "robot/pos", "robot/quat")
"""What is kept of the robot, where there is one."""
_CONTROLS = "ctrl"


def read_episode(path: Path, index: int) -> Arrays:
    """One episode with images, as arrays by short names.

    Raises:
      InputError: it has no images, or geoms that cannot be seen by ray casting without their mesh.
    """
    with EpisodeFile(path) as file:
        names = file.names(index)
        cameras = [name.removeprefix(_FRAMES) for name in names if name.startswith(_FRAMES)]
        if not cameras or "geoms/pos" not in names:
            raise InputError(f"{path}: has no images; collect it with --frames")
        camera = cameras[0]
        found = file.episode(
            index,
            [
                *(f"{_FRAMES}{camera}", f"cameras/{camera}/pos", f"cameras/{camera}/rot"),
                *(f"descriptor/intrinsics/{camera}", "descriptor/geoms", "descriptor/lights"),
                *("geoms/pos", "geoms/quat"),
                *(name for name in (*_EXTRAS, _CONTROLS) if name in names),
            ],
        )
    geoms = found["descriptor/geoms"]
    if strange := set(geoms[:, 0].astype(int)) - set(PRIMITIVES):
        raise InputError(
            f"{path}: has geoms of type {min(strange)} (mujoco.mjtGeom); primitives are known"
        )
    images = found[f"{_FRAMES}{camera}"]
    lens = Camera.from_intrinsics(
        np.zeros(3), np.eye(3), found[f"descriptor/intrinsics/{camera}"], *images.shape[1:3]
    )
    return {
        "frames": images,
        "view_pos": found[f"cameras/{camera}/pos"].astype(np.float32),
        "view_rot": found[f"cameras/{camera}/rot"].astype(np.float32),
        "lens": np.array([*lens.focal, *lens.offset], np.float32),
        "geoms": geoms.astype(np.float32),
        "pos": found["geoms/pos"],
        "quat": found["geoms/quat"],
        "lights": found["descriptor/lights"].astype(np.float32),
        **{name: found[name] for name in (*_EXTRAS, _CONTROLS) if name in found},
    }


@dataclasses.dataclass(frozen=True, eq=False)
class Store:
    """E episodes, N frames of all of them after one another.

    Attributes:
      frames: [N, H, W, 3] uint8. episode: [N] which episode a frame belongs to.
      first, length: [E] its frames. task: [E] number of the file that it comes from.
      geoms: [E, G, columns] as in `orbisim.scene.visible`, `entity` being `ABSENT` in padding.
      lights: [E, L, columns] as in `orbisim.scene.visible`.
      pos, quat: [N, G, 3 | 4] of the geoms. view_pos, view_rot: [N, 3], [N, 3, 3].
      lens: [E, 4] focal lengths and offsets. extras: [N, ...] of the robot, by name.
      controls: [N, 16] that led to a frame, zeros for an episode's first; None where not recorded.
      latents: [N, C, h, w], once they were computed. maps: [N, M, H, W], likewise.
      compiled: whether rays are cast by compiled kernels. step: time between frames, s.
    """

    frames: Tensor
    episode: Tensor
    first: Tensor
    length: Tensor
    task: Tensor
    geoms: Tensor
    pos: Tensor
    quat: Tensor
    view_pos: Tensor
    view_rot: Tensor
    lens: Tensor
    lights: Tensor
    extras: dict[str, list[Tensor]]
    controls: Tensor | None = None
    latents: Tensor | None = None
    maps: Tensor | None = None
    compiled: bool = False
    step: float = 0.05

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def size(self) -> int:
        """Height of the images, pixels."""
        return int(self.frames.shape[1])

    @property
    def device(self) -> torch.device:
        """Where it is."""
        return self.frames.device

    def solids(self, index: Tensor) -> Solids:
        """The geoms of frames [B]."""
        rows = self.geoms[self.episode[index]]
        return Solids(
            kind=rows[..., 0].long(),
            size=rows[..., 1:4],
            colour=rows[..., 4:7],
            entity=rows[..., 7].long(),
            pos=self.pos[index],
            rot=matrices(self.quat[index]),
        )

    def view(self, index: Tensor) -> View:
        """The cameras of frames [B]."""
        lens = self.lens[self.episode[index]]
        return View(self.view_pos[index], self.view_rot[index], lens[:, :2], lens[:, 2:])

    def lamps(self, index: Tensor) -> Lamps:
        """The lights of frames [B]."""
        return Lamps(self.lights[self.episode[index]])

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def conditions(self, index: Tensor, config: DenoiserConfig) -> tuple[Tensor, Tensor, Tensor]:
        """Condition maps, tokens and which of them are there, of frames [B]."""
        parts = [self._conditions(part, config) for part in index.split(_STEP)]
        found, tokens, there = (torch.cat(field) for field in zip(*parts, strict=True))
        return found, tokens, there

    def _conditions(self, index: Tensor, config: DenoiserConfig) -> tuple[Tensor, Tensor, Tensor]:
        solids, view = self.solids(index), self.view(index)
        if config.tokens == "controls":
            tokens, there = self._controls(index)
        else:
            tokens, there = tokens_of(solids, view, config)
        if self.maps is not None:
            return self.maps[index].float(), tokens, there
        lamps, size = self.lamps(index), self.size
        primitives = compiled_primitives() if self.compiled else PRIMITIVES
        found = condition_maps(solids, view, lamps, size, size, config, primitives=primitives)
        return found, tokens, there

    def _controls(self, index: Tensor) -> tuple[Tensor, Tensor]:
        if self.controls is None:
            raise InputError(
                "a model of controls needs episodes with controls; some of these have none"
            )
        return control_tokens(self.controls, index, self.first[self.episode[index]])

    def with_maps(self, config: DenoiserConfig) -> Store:
        """The same with the condition maps of all frames in half precision: 0.5 MB each at 128."""
        shape = (len(self), map_channels(config), self.size, self.size)
        found = torch.empty(shape, dtype=torch.float16, device=self.device)
        for index in torch.arange(len(self), device=self.device).split(_STEP):
            found[index] = self.conditions(index, config)[0].half()
        return dataclasses.replace(self, maps=found)

    def with_poses(self, pos: Tensor, quat: Tensor) -> Store:
        """The same frames with other poses of the geoms (predicted ones)."""
        return dataclasses.replace(self, pos=pos, quat=quat, maps=None)


def condition_maps(
    solids: Solids,
    view: View,
    lamps: Lamps,
    height: int,
    width: int,
    config: DenoiserConfig,
    meshes: Meshes = None,
    primitives: Mapping[int, Meet] = PRIMITIVES,
    kinds: tuple[int, ...] | None = None,
) -> Tensor:
    """Spatial condition maps [B, M, H, W] (see `DenoiserConfig.maps` and `left_out`).

    `kinds`: see `orbisim_diffusion.raycast.cast`.
    """
    if config.maps == "none":
        return solids.pos.new_zeros(len(solids.pos), 1, height, width)
    if config.maps == "heatmaps":
        return heatmaps(solids, view, height, width)
    rays = meshes, primitives, kinds
    return geometry_maps(solids, view, lamps, height, width, *rays, config.left_out)


def tokens_of(solids: Solids, view: View, config: DenoiserConfig) -> tuple[Tensor, Tensor]:
    """Tokens of a state, and which of them are there (see `DenoiserConfig.tokens`).

    Raises:
      InputError: the model is one of controls, which a state does not tell.
    """
    if config.tokens == "controls":
        raise InputError(
            "this checkpoint shows what controls lead to (an ablation), not states; it is for "
            "`orbisim eval vision`"
        )
    tokens, there = object_tokens(solids, view)
    return one_token(tokens, there) if config.tokens == "one" else (tokens, there)


def load(
    paths: Sequence[Path],
    device: torch.device,
    *,
    workers: int = 1,
    limit: int | None = None,
    size: int = 0,
) -> Store:
    """Reads episode files, or folders of own recordings, into a store.

    Args:
      paths: the files. device: where to. workers: processes that read.
      limit: at most so many episodes of each file, from its beginning.
      size: of the images that are made of own recordings, pixels.

    Raises:
      InputError: a file has no images, or their sizes differ.
    """
    jobs, step = [], 0.05
    own = [path for path in paths if Path(path).is_dir()]
    for number, path in enumerate(paths):
        if path not in own:
            with EpisodeFile(path) as file:
                step = file.control_timestep
                jobs += [(number, Path(path), i) for i in range(min(len(file), limit or len(file)))]
    episodes = list(track(_read_all(jobs, workers), "reading episodes", len(jobs)))
    episodes += [read_own(Path(path), size) for path in own]
    jobs += [(list(paths).index(path), Path(path), 0) for path in own]
    sizes = {episode["frames"].shape[1:] for episode in episodes}
    if len(sizes) != 1:
        raise InputError(f"images of different sizes: {sorted(sizes)}; train on one size")
    store = _assembled(episodes, [job[0] for job in jobs], device)
    return dataclasses.replace(store, step=step)


def _read_all(jobs: Sequence[tuple[int, Path, int]], workers: int) -> Any:
    if workers == 1 or len(jobs) < 2:
        yield from (read_episode(path, index) for _, path, index in jobs)
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy a device's context
    with concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield from pool.map(read_episode, [j[1] for j in jobs], [j[2] for j in jobs], chunksize=2)


def _assembled(episodes: list[Arrays], task: list[int], device: torch.device) -> Store:
    lengths = np.array([len(episode["frames"]) for episode in episodes])
    most = max(len(episode["geoms"]) for episode in episodes)
    geoms = np.zeros((len(episodes), most, len(visible.COLUMNS)), np.float32)
    geoms[..., visible.COLUMNS.index("entity")] = ABSENT
    for row, episode in zip(geoms, episodes, strict=True):
        row[: len(episode["geoms"])] = episode["geoms"]

    def joined(name: str) -> Tensor:
        return torch.cat([torch.as_tensor(episode[name]) for episode in episodes]).to(device)

    def padded(name: str) -> Tensor:
        size = episodes[0][name].shape[-1]
        out = np.zeros((int(lengths.sum()), most, size), np.float32)
        out[..., 0] = name == "quat"  # padding has a rotation, too
        row = 0
        for episode in episodes:
            values = episode[name]
            out[row : row + len(values), : values.shape[1]] = values
            row += len(values)
        return torch.as_tensor(out).to(device)

    def led() -> Tensor | None:
        if not all(_CONTROLS in episode for episode in episodes):
            return None
        out = torch.zeros(int(lengths.sum()), CONTROLS)
        for episode, row in zip(episodes, np.cumsum([0, *lengths[:-1]]), strict=True):
            values = torch.as_tensor(episode[_CONTROLS])
            if values.shape[1] > CONTROLS:
                return None
            out[row + 1 : row + 1 + len(values), : values.shape[1]] = values
        return out.to(device)

    lights = np.zeros((len(episodes), max(len(e["lights"]) for e in episodes), 9), np.float32)
    for row, episode in zip(lights, episodes, strict=True):
        row[: len(episode["lights"])] = episode["lights"]
    extras = {
        name: [torch.as_tensor(e[name]).to(device) for e in episodes]
        for name in _EXTRAS
        if all(name in e for e in episodes)
    }
    return Store(
        frames=joined("frames"),
        episode=torch.as_tensor(np.repeat(np.arange(len(episodes)), lengths)).to(device),
        first=torch.as_tensor(np.cumsum([0, *lengths[:-1]])).to(device),
        length=torch.as_tensor(lengths).to(device),
        task=torch.as_tensor(task).to(device),
        geoms=torch.as_tensor(geoms).to(device),
        pos=padded("pos"),
        quat=padded("quat"),
        view_pos=joined("view_pos"),
        view_rot=joined("view_rot"),
        lens=torch.stack([torch.as_tensor(e["lens"]) for e in episodes]).to(device),
        lights=torch.as_tensor(lights).to(device),
        extras=extras,
        controls=led(),
    )


def draw_frames(store: Store, count: int, context: int, consecutive: float) -> Tensor:
    """Frames [count, K + 1] in temporal order; the last is the target (paper, appendix B.2).

    Args:
      store: where from. count: samples. context: K.
      consecutive: probability that they follow each other; else they are any of the episode's.
    """
    device = store.device
    episode = torch.randint(len(store.first), (count,), device=device)
    room = (store.length[episode] - context).clamp_min(1)
    steps = torch.arange(context + 1, device=device)
    start = (torch.rand(count, device=device) * room).long()
    apart = (torch.rand(count, context + 1, device=device) * room[:, None]).long().sort(1).values
    together = torch.rand(count, device=device) < consecutive
    offset = torch.where(together[:, None], start[:, None], apart) + steps
    return store.first[episode][:, None] + offset.clamp_max(store.length[episode][:, None] - 1)
