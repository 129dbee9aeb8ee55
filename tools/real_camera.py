"""A camera that the scene does not declare: other lights, textures and lens, motion blur, noise.

    MUJOCO_GL=egl python tools/real_camera.py render DATA.h5 REAL.h5 [--workers 14]
    python tools/real_camera.py measure CHECKPOINT REAL.h5 DATA.h5 [--episodes 48] [--out FILE]
    python tools/real_camera.py simple REAL_TRAIN.h5 DATA_TRAIN.h5 REAL.h5 DATA.h5 [--episodes 48]

`render` takes episodes with images (`orbisim collect push --frames side`) and writes the same ones
as this camera sees them. A checkpoint trained on some of them
(`orbisim train vision REAL.h5 --start CHECKPOINT`) is measured on others: how far MuJoCo's images
of the true states are from the camera's, and how far the diffusion renderer's. `simple` measures
what needs no network: MuJoCo's images with the affine map of colours that is best on the training
episodes, and the mean image of these. Nothing in the package reads what stands here.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion.checkpoint import load_checkpoint
from orbisim_diffusion.features import Features, perceptual_distance
from orbisim_diffusion.model import Painter
from orbisim_diffusion.quality import psnr, ssim
from orbisim_diffusion.store import load
from orbisim_diffusion.workflows import Workflow, rollout
from scipy import ndimage
from torch import Tensor

from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make

CAMERA = "side"
EXPOSURE, SHARES = 0.02, (-0.5, 0.0, 0.5)
"""Time that the shutter is open, s, and when it is looked through, of that time from its middle."""
BARREL, TANGENTIAL = (-0.12, 0.03), (0.004, -0.003)
"""Brown and Conrady's coefficients of the lens, in half image heights."""
VIGNETTE, GAMMA, GAIN = 0.25, 0.9, (1.05, 0.98, 0.88)
"""Darkening in the corners, tone curve, and white balance."""
SHOT, READ = 0.4, 1.2
"""Sensor noise: variance by signal, and standard deviation without any, of 255."""
_SUPER = 2
"""Rays along a pixel's side."""

Image = npt.NDArray[np.float64]


def main() -> None:
    """Renders, or measures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="what", required=True)
    making = commands.add_parser("render")
    making.add_argument("data", type=Path)
    making.add_argument("out", type=Path)
    making.add_argument("--episodes", type=int, default=10**6, help="at most so many")
    making.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    measuring = commands.add_parser("measure")
    measuring.add_argument("checkpoint", type=Path)
    measuring.add_argument("real", type=Path)
    measuring.add_argument("data", type=Path, help="the same episodes as MuJoCo shows them")
    measuring.add_argument("--steps", type=int, nargs="+", default=[1])
    plain = commands.add_parser("simple")
    for name in ("real_train", "data_train", "real", "data"):
        plain.add_argument(name, type=Path)
    for one in (measuring, plain):
        one.add_argument("--episodes", type=int, default=48)
        one.add_argument("--no-features", action="store_true")
        one.add_argument("--out", type=Path, help="a file for the lines, too")
        one.add_argument("--workers", type=int, default=1, help="processes that read")
        one.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    if arguments.what == "render":
        render(arguments.data, arguments.out, arguments.episodes, arguments.workers)
        return
    lines = []
    for line in (measured if arguments.what == "measure" else simple)(arguments):
        lines.append(json.dumps(line))
        print(lines[-1], flush=True)
        if arguments.out:
            arguments.out.write_text("\n".join(lines) + "\n")


def render(data: Path, out: Path, episodes: int, workers: int) -> None:
    """Writes a copy of an episode file with this camera's images in the place of MuJoCo's."""
    with EpisodeFile(data) as file:
        count = min(len(file), episodes)
    part = out.with_suffix(".part")
    shutil.copyfile(data, part)
    jobs = [(data, index) for index in range(count)]
    with h5py.File(part, "r+") as file, ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        keys = sorted(file["episodes"])
        for key, frames in zip(
            keys, pool.map(photographed, *zip(*jobs, strict=True)), strict=False
        ):
            file[f"episodes/{key}/frames/{CAMERA}"][...] = frames
        for key in keys[count:]:
            del file[f"episodes/{key}"]
    part.replace(out)


def photographed(data: Path, index: int) -> npt.NDArray[np.uint8]:
    """The images [T+1, H, W, 3] of an episode."""
    with EpisodeFile(data) as file:
        known = file.attributes(index)
        arrays = file.episode(index, ["qpos", "qvel", f"frames/{CAMERA}"])
        scene = make(file.task, **file.config).scene(known["subtask"], known["seed"])
    size = arrays[f"frames/{CAMERA}"].shape[1]
    model = dressed(scene.spec).compile()
    renderer = mujoco.Renderer(model, _SUPER * size, _SUPER * size)
    rng = np.random.default_rng([known["seed"], 19])
    try:
        pairs = zip(arrays["qpos"], arrays["qvel"], strict=True)
        return np.stack([_shot(renderer, model, *pair, size, rng) for pair in pairs])
    finally:
        renderer.close()


def dressed(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The scene as it looks: wood, tiles, a lamp and a window instead of the declared lights."""
    kinds = mujoco.mjtTexture
    for name, first, second, mark in (
        ("table", (0.55, 0.38, 0.24), (0.68, 0.5, 0.33), (0.4, 0.27, 0.17)),
        ("floor", (0.32, 0.34, 0.4), (0.52, 0.52, 0.5), (0.2, 0.2, 0.25)),
    ):
        texture = spec.add_texture(
            name=f"real_{name}",
            type=kinds.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        )
        texture.width = texture.height = 256
        texture.rgb1, texture.rgb2, texture.markrgb = first, second, mark
        texture.mark, texture.random = mujoco.mjtMark.mjMARK_RANDOM, 0.03
        material = spec.add_material(name=f"real_{name}", texrepeat=[6, 6], specular=0.5)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = f"real_{name}"
        spec.geom(name).material, spec.geom(name).rgba = f"real_{name}", [1, 1, 1, 1]
    for light in list(spec.lights):
        spec.delete(light)
    lamp = spec.worldbody.add_light(pos=[0.1, -0.5, 1.3], dir=[0.4, 0.5, -1.0])
    lamp.diffuse, lamp.specular = [0.75, 0.62, 0.45], [0.5, 0.45, 0.4]
    window = spec.worldbody.add_light(pos=[1.5, 0.6, 1.6], dir=[-0.9, -0.4, -1.0])
    window.diffuse, window.type = [0.3, 0.36, 0.45], mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.visual.headlight.diffuse, spec.visual.headlight.ambient = [0.1] * 3, [0.3, 0.29, 0.27]
    return spec


def _shot(
    renderer: mujoco.Renderer,
    model: mujoco.MjModel,
    qpos: npt.NDArray[np.float64],
    qvel: npt.NDArray[np.float64],
    size: int,
    rng: np.random.Generator,
) -> npt.NDArray[np.uint8]:
    """One image: the mean over the exposure, through the lens, on the sensor."""
    data, total = mujoco.MjData(model), np.zeros((_SUPER * size, _SUPER * size, 3))
    for share in SHARES:
        data.qpos[:] = qpos
        mujoco.mj_integratePos(model, data.qpos, qvel, share * EXPOSURE)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        renderer.update_scene(data, CAMERA)
        total += renderer.render() / (255.0 * len(SHARES))
    bent = distorted(total).reshape(size, _SUPER, size, _SUPER, 3).mean((1, 3))
    return developed(bent, rng)


def distorted(image: Image) -> Image:
    """The image [H, H, 3] through a lens of Brown and Conrady's model."""
    half = (len(image) - 1) / 2
    y, x = (np.mgrid[: len(image), : len(image)] - half) / half
    square = x * x + y * y
    radial = 1.0 + BARREL[0] * square + BARREL[1] * square**2
    p, q = TANGENTIAL
    xs = x * radial + 2 * p * x * y + q * (square + 2 * x * x)
    ys = y * radial + p * (square + 2 * y * y) + 2 * q * x * y
    where = np.stack([ys, xs]) * half + half
    planes = [
        ndimage.map_coordinates(image[..., c], where, order=1, mode="nearest") for c in range(3)
    ]
    return np.stack(planes, axis=-1)


def developed(image: Image, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """What the sensor makes of light [H, W, 3] from 0 to 1: 8 bits."""
    half = (len(image) - 1) / 2
    y, x = (np.mgrid[: len(image), : len(image)] - half) / half
    dim = 1.0 - VIGNETTE * (x * x + y * y)[..., None] / 2
    light = 255.0 * np.clip(image * dim * GAIN, 0.0, 1.0) ** GAMMA
    noise = rng.standard_normal(light.shape) * np.sqrt(READ**2 + SHOT * light / 10.0)
    return np.clip(np.round(light + noise), 0, 255).astype(np.uint8)


def measured(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Means over frames 1 to 100 of held-out episodes, all from the true states."""
    device = torch.device(arguments.device)
    painter = Painter.of(load_checkpoint(arguments.checkpoint), device)
    how = {"workers": arguments.workers, "limit": arguments.episodes}
    real = load([arguments.real], device, **how)
    plain = load([arguments.data], device, limit=len(real.first), workers=arguments.workers)
    horizon = min(100, int(real.length.min()) - 1)
    index = real.first[:, None] + torch.arange(1, horizon + 1, device=device)
    true = real.frames[index]
    features = None if arguments.no_features else Features(device)
    yield {"renderer": "mujoco", **_compared(plain.frames[index], true, features)}
    workflows: tuple[Workflow, ...] = ("Recon-all", "Recon-first", "GT-state")
    for workflow in workflows:
        for steps in arguments.steps:
            parts = torch.arange(len(real.first), device=device).split(32)
            video = torch.cat([rollout(painter, real, p, workflow, horizon, steps) for p in parts])
            line = {"renderer": "diffusion", "workflow": workflow, "steps": steps}
            yield {**line, **_compared(video, true, features)}


def simple(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Means over frames 1 to 100 of held-out episodes, of what needs no network."""
    device = torch.device(arguments.device)
    how = {"workers": arguments.workers, "limit": arguments.episodes}
    seen, drawn = (load([p], device, **how) for p in (arguments.real_train, arguments.data_train))
    count = min(len(seen.frames), len(drawn.frames))
    inputs, wanted = (s.frames[:count].reshape(-1, 3).double() for s in (drawn, seen))
    one = torch.ones_like(inputs[:, :1])
    inputs = torch.cat([inputs, one], 1)
    # four columns and millions of rows: cuSOLVER's least squares refuses that many
    colours = torch.linalg.solve(inputs.T @ inputs, inputs.T @ wanted)
    real, plain = (load([p], device, **how) for p in (arguments.real, arguments.data))
    horizon = min(100, int(real.length.min()) - 1)
    index = real.first[:, None] + torch.arange(1, horizon + 1, device=device)
    features = None if arguments.no_features else Features(device)
    true, video = real.frames[index], plain.frames[index]
    mapped = video.double() @ colours[:3] + colours[3]
    rows = {
        "mujoco": video,
        "mujoco, colours fitted": mapped.round().clamp(0, 255).to(torch.uint8),
        "mean training image": seen.frames.float().mean(0).round().to(torch.uint8).expand_as(true),
    }
    for name, found in rows.items():
        yield {"renderer": name, **_compared(found, true, features)}


def _compared(found: Tensor, true: Tensor, features: Features | None) -> dict[str, float]:
    pairs = list(zip(found.flatten(0, 1).split(256), true.flatten(0, 1).split(256), strict=True))
    scores = {
        "psnr": torch.cat([psnr(*pair) for pair in pairs]),
        "ssim": torch.cat([ssim(*pair) for pair in pairs]),
    }
    if features is not None:
        scores["EffNet-PD"] = torch.cat([perceptual_distance(features, *pair) for pair in pairs])
    return {name: round(float(values.mean()), 4) for name, values in scores.items()}


if __name__ == "__main__":
    main()
