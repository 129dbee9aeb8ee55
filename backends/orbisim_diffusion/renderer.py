"""`DiffusionRenderer`: OrbiSim-Vision as a renderer like any other."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from orbisim_world_model.watch import OutsideTrainingWarning
from torch import Tensor

from orbisim import cameras
from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.renderer import Mode, Renderer
from orbisim.scene import Scene
from orbisim.state import State
from orbisim_diffusion import zoo
from orbisim_diffusion.autoencoder import to_bytes, to_float
from orbisim_diffusion.checkpoint import Checkpoint, load_checkpoint
from orbisim_diffusion.config import MOST_CONTEXT, PATCH
from orbisim_diffusion.denoiser import Condition
from orbisim_diffusion.kinematics import Kinematics
from orbisim_diffusion.loop import mixed
from orbisim_diffusion.model import MOST_STEPS, Painter
from orbisim_diffusion.playback import Recorded
from orbisim_diffusion.scope import scene_concerns, scene_problem, view_problem
from orbisim_diffusion.shapes import PRIMITIVES, compiled_primitives
from orbisim_diffusion.solids import View
from orbisim_diffusion.store import condition_maps, tokens_of

LATENTS, TIMES, VIEWS = "diffusion_latents", "diffusion_times", "diffusion_views"
"""Names in `State.memory`: latents of past frames [nworld, 6, C, h, w], when they were shown
[nworld, 6] (infinity: empty), and by which camera [nworld, 6, 14]."""
_WIDEST = 4.0
"""Largest ratio of an image's sides."""
_SAME_VIEW = 1e-4
"""Largest difference of a camera's numbers (m, units) that is rounding and not a motion."""


class Frame(NamedTuple):
    """What is asked for: number of the camera, and the size of the image in pixels."""

    camera: int
    height: int
    width: int


class DiffusionRenderer(Renderer):
    """Renders states with a latent diffusion model that sees their geometry.

    `render` is a function of the state alone: the frames shown before, which the model continues,
    are in `State.memory`, where `observe` puts them. The same state gives the same image.

    Args:
      argument: folder of a checkpoint (`diffusion:PATH`); the zoo's that fits the scene if None.
      steps: of the sampler; 1 uses the one-step model where the checkpoint has one.
      seed: of the noise that sampling starts from.
      context: whether earlier frames are continued; else each is made from its state alone.
      device: `cpu`, `cuda`, `cuda:1`; None for the GPU, if there is one.
      compiled: whether torch compiles the ray casting: half a minute at the first image, then fewer
        and larger kernels.
      graph: whether a GPU's work is recorded once for each number of worlds, length of context and
        size of image, and played back as a whole (a CUDA graph): nothing is started kernel by
        kernel then. The images are the same.
    """

    name = "diffusion"
    modes: frozenset[Mode] = frozenset({"rgb"})
    memory = frozenset({LATENTS, TIMES, VIEWS})

    def __init__(
        self,
        *,
        argument: str | None = None,
        steps: int = 1,
        seed: int = 0,
        context: bool = True,
        device: str | None = None,
        compiled: bool = False,
        graph: bool = False,
    ) -> None:
        if not 1 <= steps <= MOST_STEPS:
            raise InputError(f"a sampler takes 1 to {MOST_STEPS} steps; got {steps}")
        if seed < 0:
            raise InputError(f"a seed is at least 0; got {seed}")
        self._folder = Path(argument) if argument else None
        self._steps, self._seed, self._context = steps, seed, context
        self._device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        if graph and self._device.type != "cuda":
            raise InputError(f"graph=True records a GPU's work; the device is {self._device}")
        self._primitives = compiled_primitives() if compiled else PRIMITIVES
        self._graph = graph
        self._recorded: dict[tuple[Any, ...], Recorded] = {}
        self._checkpoint: Checkpoint | None = None

    @property
    def checkpoint(self) -> Checkpoint:
        """The checkpoint in use.

        Raises:
          InputError: no scene was loaded.
        """
        if self._checkpoint is None:
            raise InputError("renderer 'diffusion' has no scene yet; call load first")
        return self._checkpoint

    def load(self, scene: Scene) -> None:
        """Finds the checkpoint and prepares to see the scene's geoms.

        Raises:
          UnsupportedSceneError: the checkpoint was trained on other scenes.
          InputError: the checkpoint cannot be read.
        """
        kinematics = Kinematics(scene, self._device)
        folder = self._folder or zoo.find(scene, kinematics.rows)
        if self._checkpoint is None or self._checkpoint.path != folder:
            checkpoint = load_checkpoint(folder)
            self.painter = Painter.of(checkpoint, self._device)
        else:
            checkpoint = self._checkpoint
        if problem := scene_problem(checkpoint.scope, kinematics.rows):
            raise UnsupportedSceneError(
                scene.source,
                f"{folder}: {problem}",
                remedy="train a checkpoint on it (orbisim train vision) or use 'mujoco'",
            )
        for concern in scene_concerns(checkpoint.scope, kinematics.rows):
            text = f"renderer 'diffusion', scene {scene.name!r}: {concern}"
            warnings.warn(text, OutsideTrainingWarning, stacklevel=2)
        self._checkpoint, self.kinematics, self._scene = checkpoint, kinematics, scene
        self._kinds = tuple(int(kind) for kind in kinematics.rows[:, 0])
        self._recorded.clear()
        self._still: dict[int, View] = {}

    def render(
        self,
        state: State,
        *,
        world: int = 0,
        camera: int | str = -1,
        height: int = 240,
        width: int = 320,
        mode: Mode = "rgb",
    ) -> npt.NDArray[Any]:
        """Renders one world (see `orbisim.renderer.Renderer.render`)."""
        if not 0 <= world < state.nworld:
            raise InputError(f"world {world} is not among the state's {state.nworld} worlds")
        return self.observe(state[world], camera=camera, height=height, width=width, mode=mode)[0][
            0
        ]

    def render_batch(self, state: State, **options: Any) -> npt.NDArray[Any]:
        """Renders every world at once: [nworld, height, width, 3]."""
        return self.observe(state, **options)[0]

    def observe(  # type: ignore[override]
        self,
        state: State,
        *,
        camera: int | str = -1,
        height: int = 240,
        width: int = 320,
        mode: Mode = "rgb",
    ) -> tuple[npt.NDArray[Any], Mapping[str, npt.NDArray[Any]]]:
        """Every world's image, and the memory with which the next one continues it."""
        self.check_mode(mode)
        frame = self._frame(camera, height, width)
        state = state.numpy()
        with torch.no_grad():
            qpos = torch.as_tensor(state.qpos, dtype=torch.float32, device=self._device)
            view = self._view(qpos, frame)
            noise, past = self._noise(state, frame), self._past(state, view, frame)
            images, latents = self._shown(qpos, noise, past, frame, (height, width))
        return images.cpu().numpy(), self._remembered(state, latents, view)

    def latents(
        self, qpos: Tensor, *, camera: int | str = -1, height: int = 240, width: int = 320
    ) -> Tensor:
        """The latents [B, C, h, w] of coordinates [B, nq], with gradients to them.

        Without context; `painter.decode` makes images [B, 3, H, W] from -1 to 1 of them.
        """
        frame = self._frame(camera, height, width)
        count = len(qpos)
        blank = State(
            np.zeros(count), np.zeros((count, 1)), np.zeros((count, 1)), np.zeros((count, 0))
        )
        self._view(qpos, frame)
        noise = self._noise(blank, frame)
        return self._latents(qpos, noise, noise.new_zeros(count, 0, *noise.shape[1:]), frame)

    def remembering(self, state: State, image: npt.NDArray[np.uint8], camera: int | str) -> State:
        """The state with an image [H, W, 3] of it, from wherever, as the frame shown last.

        Raises:
          InputError: the image is not of the size that the checkpoint works at, or the state has
            more than one world.
        """
        size = self.checkpoint.config.size
        if image.ndim != 3 or image.shape[0] != size or image.shape[1] % PATCH or state.nworld != 1:
            raise InputError(
                f"an image of one world, {size} pixels high and a multiple of {PATCH} wide, can be "
                f"remembered; got {image.shape} and {state.nworld} worlds"
            )
        frame = self._frame(camera, *image.shape[:2])
        host = state.numpy()
        with torch.no_grad():
            qpos = torch.as_tensor(host.qpos, dtype=torch.float32, device=self._device)
            pixels = torch.as_tensor(np.array(image), device=self._device)
            latents = self.painter.encode(to_float(pixels[None]))
        return host.with_memory(**self._remembered(host, latents, self._view(qpos, frame)))

    # -- inner workings ------------------------------------------------------------------------

    def _frame(self, camera: int | str, height: int, width: int) -> Frame:
        number = cameras.camera_number(self.kinematics.model, camera, self._scene.name)
        if min(height, width) < 1 or not 1 / _WIDEST <= width / height <= _WIDEST:
            raise InputError(
                f"images are at most {_WIDEST:g} times as long as wide; got {height} x {width}"
            )
        size = self.checkpoint.config.size
        return Frame(number, size, max(1, round(size * width / height / PATCH)) * PATCH)

    def _view(self, qpos: Tensor, frame: Frame) -> View:
        """The cameras of worlds at coordinates [B, nq]; one that stands still is looked up once."""
        model, camera = self.kinematics.model, frame.camera
        carried = camera >= 0 and model.body_weldid[model.cam_bodyid[camera]] != 0
        if carried or camera not in self._still:
            view = self.kinematics.view(qpos, camera)
            pos, rot, focal = (v[0].detach().cpu().double().numpy() for v in view[:3])
            seen = cameras.Camera(pos, rot, (float(focal[0]), float(focal[1])))
            if problem := view_problem(self.checkpoint.scope, seen):
                raise InputError(f"renderer 'diffusion', {self.checkpoint.path}: {problem}")
            if carried:
                return view
            self._still[camera] = View(*(field[:1].detach().cpu() for field in view))
        return View(*(v.expand(len(qpos), *v.shape[1:]) for v in self._still[camera]))

    def _shown(
        self,
        qpos: Tensor,
        noise: Tensor,
        past: list[list[Tensor]],
        frame: Frame,
        size: tuple[int, int],
    ) -> tuple[Tensor, Tensor]:
        """Images [B, H, W, 3] of bytes and latents [B, C, h, w] of all worlds.

        Those with equally many frames to continue are made together.
        """
        images = torch.empty((len(qpos), *size, 3), dtype=torch.uint8, device=self._device)
        latents = torch.empty_like(noise)
        for count in sorted({len(frames) for frames in past}):
            worlds = [i for i, frames in enumerate(past) if len(frames) == count]
            some = slice(None) if len(worlds) == len(qpos) else worlds
            context = noise.new_zeros((len(worlds), 0, *noise.shape[1:]))
            if count:
                context = torch.stack([torch.stack(past[i]) for i in worlds])
            made = self._made((qpos[some], noise[some], context), frame, size)
            images[some], latents[some] = made
        return images, latents

    def _made(
        self, given: tuple[Tensor, Tensor, Tensor], frame: Frame, size: tuple[int, int]
    ) -> tuple[Tensor, Tensor]:
        """Images and latents of coordinates, noise and context, played back where recorded."""
        if not self._graph:
            return self._drawn(given, frame, size)
        key = (len(given[0]), given[2].shape[1], frame, size)
        if key not in self._recorded:
            before = next(iter(self._recorded.values()), None)
            self._recorded[key] = Recorded(lambda *x: self._drawn(x, frame, size), given, before)
        images, latents = self._recorded[key](given)
        return images, latents

    def _drawn(
        self, given: tuple[Tensor, ...], frame: Frame, size: tuple[int, int]
    ) -> tuple[Tensor, Tensor]:
        qpos, noise, context = given
        latents = self._latents(qpos, noise, context, frame)
        with mixed(self._device):
            images = self.painter.decode(latents)
        return to_bytes(resized(images.float(), *size)), latents

    def _latents(self, qpos: Tensor, noise: Tensor, context: Tensor, frame: Frame) -> Tensor:
        """Of worlds with equally many frames [B, K, C, h, w] to continue.

        The host waits for nothing here, so that the work can be recorded.
        """
        poses = self.kinematics.bodies(qpos)
        view = self.kinematics.view(qpos, frame.camera, poses)
        solids, lamps = self.kinematics.solids(qpos, poses), self.kinematics.lamps(len(qpos))
        settings = self.painter.config.denoiser
        maps = condition_maps(
            *(solids, view, lamps, frame.height, frame.width, settings),
            *(self.kinematics.meshes, self._primitives, self._kinds),
        )
        tokens, there = tokens_of(solids, view, settings)
        history = self.painter.history(context.unbind(1), len(qpos), maps)
        # half precision is for the network alone: poses and rays need all their digits
        with nullcontext() if torch.is_grad_enabled() else mixed(self._device):
            made = self.painter.paint(Condition(*history, maps, tokens, there), noise, self._steps)
        return made.float()

    def _kept(self, state: State, view: View, shape: Sequence[int]) -> list[list[int]]:
        """For each world the places of frames to continue: earlier ones, of this camera.

        Args:
          state: with its memory. view: the camera. shape: [C, h, w] of its latents.
        """
        memory = state.memory
        if not self._context or not self.memory <= memory.keys():
            return [[]] * state.nworld
        if memory[LATENTS].shape[2:] != tuple(shape):
            return [[]] * state.nworld
        same = np.abs(memory[VIEWS] - _view_rows(view)[:, None]).max(-1) < _SAME_VIEW
        earlier = memory[TIMES] < np.asarray(state.time)[:, None] - 1e-9
        return [np.flatnonzero(row).tolist() for row in same & earlier]

    def _past(self, state: State, view: View, frame: Frame) -> list[list[Tensor]]:
        """For each world the latents to continue, oldest first."""
        kept = self._kept(state, view, self._shape(frame))
        if not any(kept):
            return [[]] * state.nworld
        latents = np.asarray(state.memory[LATENTS], np.float32)
        stored = torch.as_tensor(latents, device=self._device)  # one copy for all worlds
        return [[stored[world, k] for k in places] for world, places in enumerate(kept)]

    def _shape(self, frame: Frame) -> tuple[int, int, int]:
        """[C, h, w] of a frame's latents."""
        channels = self.painter.config.autoencoder.channels
        return channels, frame.height // PATCH, frame.width // PATCH

    def _remembered(self, state: State, latents: Tensor, view: View) -> dict[str, npt.NDArray[Any]]:
        """The memory with these latents after what is still earlier."""
        made, rows = latents.detach().float().cpu().numpy(), _view_rows(view)
        count = state.nworld
        frames = np.zeros((count, MOST_CONTEXT, *made.shape[1:]), np.float32)
        times = np.full((count, MOST_CONTEXT), np.inf)
        views = np.tile(rows[:, None], (1, MOST_CONTEXT, 1))
        for world, kept in enumerate(self._kept(state, view, made.shape[1:])):
            last = kept[1 - MOST_CONTEXT :]
            if last:
                frames[world, : len(last)] = state.memory[LATENTS][world, last]
                times[world, : len(last)] = state.memory[TIMES][world, last]
            frames[world, len(last)], times[world, len(last)] = made[world], state.time[world]
        return {LATENTS: frames, TIMES: times, VIEWS: views}

    def _noise(self, state: State, frame: Frame) -> Tensor:
        """Unit noise [B, C, h, w]: a function of the seed and of each world's time."""
        rows = []
        for time in np.asarray(state.time, np.float64):
            microseconds = round(abs(float(time)) * 1e6) % 2**40
            rng = np.random.default_rng([self._seed, microseconds])
            rows.append(rng.standard_normal(self._shape(frame), np.float32))
        return torch.as_tensor(np.stack(rows), device=self._device)


def resized(images: Tensor, height: int, width: int) -> Tensor:
    """Images [N, 3, H, W] at another size."""
    if images.shape[-2:] == (height, width):
        return images
    return torch.nn.functional.interpolate(
        images, (height, width), mode="bicubic", antialias=True, align_corners=False
    )


def _view_rows(view: View) -> npt.NDArray[np.float64]:
    """[B, 14]: position, rotation, focal lengths."""
    rows = torch.cat([view.pos, view.rot.flatten(1), view.focal], dim=1)
    return rows.detach().cpu().double().numpy()
