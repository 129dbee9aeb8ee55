"""Cubes' poses read off images of two cameras.

A network of convolutions whose last maps are turned into places in the image by a spatial softmax
(Finn et al. 2016), trained on images of the demonstrations and where the cubes were in them. What
the robot knows without seeing helps where the hand hides a cube that it holds.
"""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from processes import spawned
from safetensors.torch import load_file
from torch import nn

from cloning.policy import demonstrations, save
from cloning.seen import OWN, Seen
from orbisim.tasks import EpisodeFile
from orbisim.tasks.stack import Stack

CAMERAS = ("side", "front")
SIZE = 128
EVERY = 5
"""Control steps between images of a demonstration."""
COLOURS = ((0.8, 0.2, 0.2), (0.2, 0.7, 0.2), (0.2, 0.3, 0.8))
"""Of the cubes in their order: an image says nothing else of which is which."""
MAPS = 32
"""Places in the image that each camera's maps are turned into."""
RATE = 1e-3
_AT_ONCE = 256
"""Looks, where nothing is learnt."""
NEAR = 0.02
"""m: unit of the loss of positions; an error of 2 cm counts as much as one of the angle's order."""


class Camera:
    """Draws one scene."""

    def __init__(self, model: mujoco.MjModel) -> None:
        for number, colour in enumerate(COLOURS, 1):
            model.geom(f"cube{number}").rgba[:3] = colour
        self._renderer = mujoco.Renderer(model, SIZE, SIZE)

    def __call__(self, data: mujoco.MjData) -> npt.NDArray[np.uint8]:
        """[cameras, SIZE, SIZE, 3]."""
        images = []
        for camera in CAMERAS:
            self._renderer.update_scene(data, camera)
            images.append(self._renderer.render())
        return np.stack(images)

    def close(self) -> None:
        """Frees the context."""
        self._renderer.close()


class Eyes(nn.Module):
    """Images [N, cameras, SIZE, SIZE, 3] and what the robot knows [N, OWN] to positions [N, 3, 3],
    m, and the sine and cosine of four times the turns [N, 3, 2]."""

    def __init__(self) -> None:
        super().__init__()
        self.maps = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(3, 32, 5, stride=2, padding=2), nn.ReLU(),
                nn.Conv2d(32, 48, 3, padding=1), nn.ReLU(),
                nn.Conv2d(48, 48, 3, padding=1), nn.ReLU(),
                nn.Conv2d(48, MAPS, 1),
            )
            for _ in CAMERAS
        )  # fmt: skip
        self.net = nn.Sequential(
            nn.Linear(len(CAMERAS) * MAPS * 3 + OWN, 512), nn.ReLU(),
            nn.Linear(512, 512), nn.ReLU(), nn.Linear(512, 15),
        )  # fmt: skip
        self.register_buffer("middle", torch.tensor([0.5, 0.0, 0.05]))

    def forward(self, images: torch.Tensor, own: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        rows = [own]
        for number, layers in enumerate(self.maps):
            maps = layers(images[:, number].movedim(-1, 1).float() / 255 - 0.5)
            place = maps.flatten(2).softmax(-1).unflatten(-1, maps.shape[2:])
            line = torch.linspace(-1, 1, maps.shape[-1], device=maps.device)
            rows += [(place.sum(2) * line).sum(-1), (place.sum(3) * line).sum(-1)]
            rows.append(maps.mean((2, 3)))
        found = self.net(torch.cat(rows, dim=1))
        pos = found[:, :9].unflatten(1, (3, 3)) / 10 + self.middle
        return pos, found[:, 9:].unflatten(1, (3, 2))

    def look(self, images: npt.NDArray[np.uint8], seen: Seen) -> Seen:
        """What is seen, with the cubes' poses as they are read off the images."""
        with torch.no_grad():
            pos, waves = self(torch.as_tensor(images), torch.as_tensor(seen.own()))
        yaw = torch.atan2(waves[..., 0], waves[..., 1]) / 4
        return dataclasses.replace(seen, cubes=pos.double().numpy(), yaw=yaw.double().numpy())


def drawn(path: Path, out: Path, index: int) -> int:
    """Images of one demonstration, every EVERY steps, in a file of their own."""
    target = out / f"images_{index:06d}.npy"
    if target.exists():
        return 0
    with EpisodeFile(path) as file:
        known = file.attributes(index)
        qpos = file.episode(index, ("qpos",))["qpos"]
    model = Stack().scene(known["subtask"], known["seed"]).model
    data = mujoco.MjData(model)
    try:
        camera = Camera(model)
    except Exception as error:  # of EGL's own kinds, which do not come back from a process
        raise RuntimeError(
            f"demonstration {index}: no OpenGL context to draw with ({error!r})"
        ) from None
    images = []
    for row in qpos[:-1:EVERY]:
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        images.append(camera(data))
    camera.close()
    part = target.with_suffix(".part.npy")
    np.save(part, np.array(images))
    part.replace(target)
    return len(images)


def draw(options: Any) -> None:
    """Draws demonstrations that succeed; what is drawn already stays."""
    options.out.mkdir(parents=True, exist_ok=True)
    lessons = demonstrations(options.data, options.demonstrations)
    seen, numbers, rows = lessons.seen, lessons.numbers, slice(None, None, EVERY)
    target = options.out / "seen.npz"
    np.savez(
        target, own=seen.own()[rows], cubes=seen.cubes[rows], yaw=seen.yaw[rows], numbers=numbers
    )
    began = time.monotonic()
    jobs = ([options.data] * len(numbers), [options.out] * len(numbers), numbers)
    with spawned(options.workers) as pool:
        total = sum(pool.map(drawn, *jobs, chunksize=4))
    print(json.dumps({"looks": total, "seconds": round(time.monotonic() - began, 1)}), flush=True)


def train(options: Any) -> dict[str, Any]:
    """Trains and writes eyes; a twentieth of the demonstrations is kept to measure on."""
    torch.manual_seed(options.seed)
    device = torch.device(options.device)
    known = np.load(options.images / "seen.npz")
    files = [options.images / f"images_{number:06d}.npy" for number in known["numbers"]]
    there = [path.exists() for path in files]  # drawing may have been cut short
    if not any(there):
        raise SystemExit(f"{options.images}: no demonstration is drawn; run `draw` first")
    images = torch.cat([torch.as_tensor(np.load(p)).to(device) for p in files if p.exists()])
    each = len(known["own"]) // len(files)  # episodes are of one length
    kept = np.repeat(there, each)
    own, cubes, yaw = (
        torch.as_tensor(known[n][kept]).float().to(device) for n in ("own", "cubes", "yaw")
    )
    waves = torch.stack([(4 * yaw).sin(), (4 * yaw).cos()], dim=-1)
    learnt = len(images) - each * max(1, sum(there) // 20)
    eyes = Eyes().to(device)
    optimizer = torch.optim.AdamW(eyes.parameters(), lr=RATE, weight_decay=1e-4)
    began, every = time.monotonic(), max(1, options.steps // 20)
    step = 0
    while step < options.steps and time.monotonic() - began < options.time_limit:
        spent = max(step / options.steps, (time.monotonic() - began) / options.time_limit)
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.5 * (1 + np.cos(np.pi * spent)) + 1e-6
        pick = torch.randint(learnt, (options.batch,), device=device)
        found = eyes(images[pick], own[pick])
        place = nn.functional.smooth_l1_loss(found[0] / NEAR, cubes[pick] / NEAR, beta=0.1)
        turn = nn.functional.mse_loss(found[1], waves[pick])
        optimizer.zero_grad()
        (place + turn).backward()
        optimizer.step()
        step += 1
        if step % every == 0:
            line = {"step": step, "place": float(place.detach()), "turn": float(turn.detach())}
            print(json.dumps({**line, "seconds": round(time.monotonic() - began, 1)}), flush=True)
    notes = {"demonstrations": sum(there), "looks": len(images), "steps": step,
             "seed": options.seed, **_errors(eyes, images, own, cubes, yaw, learnt)}  # fmt: skip
    save(eyes.half(), options.out, notes)
    return notes


def _errors(
    eyes: Eyes, images: torch.Tensor, own: torch.Tensor, cubes: torch.Tensor, yaw: torch.Tensor,
    first: int,
) -> dict[str, Any]:  # fmt: skip
    """On the looks from `first` on: mm and degrees, median and 90 %."""
    away, angle = [], []
    with torch.no_grad():
        for rows in torch.arange(first, len(images)).split(_AT_ONCE):
            pos, waves = eyes(images[rows], own[rows])
            away.append(1e3 * (pos - cubes[rows]).norm(dim=-1).flatten())
            off = 4 * yaw[rows] - torch.atan2(waves[..., 0], waves[..., 1])
            angle.append(torch.rad2deg(torch.atan2(off.sin(), off.cos()) / 4).abs().flatten())
    levels = torch.tensor([0.5, 0.9], device=cubes.device)
    return {
        "held_out_mm": torch.cat(away).quantile(levels).tolist(),
        "held_out_deg": torch.cat(angle).quantile(levels).tolist(),
    }


def load_eyes(folder: Path) -> Eyes:
    """Eyes that were trained."""
    eyes = Eyes()
    tensors = load_file(folder / "weights.safetensors")
    eyes.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    return eyes.eval()
