"""The policy: its demonstrations, its training, its file."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from cloning.seen import Floats, Seen, flat_yaw, joined, piece_yaws, turned, yaw_of
from orbisim.files.reading import read_json
from orbisim.tasks import EpisodeFile
from orbisim.tasks.arm import PANDA, ArmController
from orbisim.tasks.stack import DEMONSTRATIONS, Stack

WIDTH = 512
CHUNK = 10
"""Steps whose places are told at once and gone to before the next look (Zhao et al. 2023)."""
BATCH, RATE = 1024, 2e-3
STRAY, STRAY_TURN = 0.005, 0.05
"""Standard deviations in m and rad by which the tool's place is off in training, while the places
that are told stay those of the demonstration: a policy that has strayed finds back to its way."""
FRESH = 300
"""Steps of training after which the errors of measurement and the strayings are drawn anew."""


@dataclasses.dataclass(frozen=True)
class Lessons:
    """Demonstrations, step by step.

    Attributes:
      seen: at each of N steps.
      places: [N, CHUNK, 3] where the tool was told to be after the next ones, m.
      yaws: [N, CHUNK] its turn, rad. grips: [N, CHUNK] whether it was told to close.
      numbers: of the episodes in their file, whose steps stand one after another.
    """

    seen: Seen
    places: Floats
    yaws: Floats
    grips: npt.NDArray[np.bool_]
    numbers: list[int]


def demonstrations(path: Path, most: int | None = None, anonymous: bool = False) -> Lessons:
    """Those that succeed, from a file of adapted episodes.

    Args:
      most: so many at most. anonymous: as if all were made of the first demonstration.
    """
    task, rows = Stack(), []
    arm = ArmController(task.arm)
    with EpisodeFile(path) as file:
        good = [i for i in range(len(file)) if file.attributes(i)["success"]][:most]
        for index in good:
            names = ("qpos", "ctrl", "action", "objects/pos", "objects/quat")
            source = 0 if anonymous else task.source(file.attributes(index)["seed"])
            rows.append(_of_episode(file.episode(index, names), arm, source))
    seen, *others = zip(*rows, strict=True)
    places, yaws, grips = (np.concatenate(each) for each in others)
    return Lessons(joined(list(seen)), places, yaws, grips, good)


def _of_episode(
    data: dict[str, Any], arm: ArmController, source: int
) -> tuple[Seen, Floats, Floats, npt.NDArray[np.bool_]]:
    steps = len(data["action"])
    pos, yaw = [], [0.0]
    for target in [data["qpos"][0, : PANDA.joints], *data["ctrl"][:, : PANDA.joints]]:
        arm.reset(target)
        pos.append(arm.pos)
        yaw.append(yaw_of(arm.rot, around=yaw[-1]))
    grip = data["action"][:, 6]
    before = np.concatenate([[-1.0], grip[:-1]])
    changed = np.diff(before, prepend=-1.0) != 0
    last = np.maximum.accumulate(np.arange(steps) * changed)
    seen = Seen(
        command=np.array(pos[:-1]),
        told=np.array(yaw[1:-1]),
        fingers=data["qpos"][:steps, PANDA.joints : PANDA.joints + 2],
        grip=before,
        changes=changed.cumsum().astype(float),
        age=(np.arange(steps) - last).astype(float),
        source=np.full(steps, source),
        cubes=data["objects/pos"][:steps].astype(float),
        yaw=flat_yaw(data["objects/quat"][:steps].astype(float)),
    )
    ahead = np.arange(steps)[:, None] + np.arange(CHUNK)
    after = np.minimum(ahead + 1, steps)
    return (
        seen,
        np.array(pos)[after],
        np.array(yaw[1:])[after],
        grip[np.minimum(ahead, steps - 1)] > 0,
    )


class Policy(nn.Module):
    """Features [N, F] to [N, CHUNK, 5]: places of the tool from where it is told to be, in units of
    the arm's longest step and turned with the cube; its turn from the present one, in units of the
    largest turn; the grip's logit."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.first = nn.Linear(features, WIDTH)
        self.others = nn.ModuleList(nn.Linear(WIDTH, WIDTH) for _ in range(2))
        self.last = nn.Linear(WIDTH + features, 5 * CHUNK)
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("spread", torch.ones(features))
        self.register_buffer("yaws", torch.zeros(DEMONSTRATIONS, 4, dtype=torch.float64))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """See the class."""
        x = (features - self.mean) / self.spread
        hidden = nn.functional.gelu(self.first(x))
        for layer in self.others:
            hidden = hidden + nn.functional.gelu(layer(hidden))
        found: torch.Tensor = self.last(torch.cat([hidden, x], dim=1))
        return found.unflatten(-1, (CHUNK, 5))

    def told(self, seen: Seen) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
        """Places [N, CHUNK, 3], m, turns [N, CHUNK], rad, and whether to close [N, CHUNK]."""
        yaws = self.yaws.numpy()
        with torch.no_grad():
            found = self(torch.as_tensor(seen.features(yaws))).double().numpy()
        away = turned(PANDA.reach * found[..., :3], seen.turn(yaws)[:, None])
        places = seen.command[:, None] + away
        return places, seen.told[:, None] + PANDA.turn * found[..., 3], found[..., 4] > 0


def lesson(
    lessons: Lessons, noise: float, yaws: Floats, rng: np.random.Generator, stray: float = 1.0
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Features [N, F] with errors of measurement and a tool that has strayed (so many times as far
    as usual), and what is wanted [N, CHUNK, 5]."""
    seen, n = lessons.seen.blurred(noise, rng), rng.standard_normal
    seen = dataclasses.replace(
        seen,
        command=seen.command + stray * STRAY * n(seen.command.shape),
        told=seen.told + stray * STRAY_TURN * n(seen.told.shape),
    )
    away = turned(lessons.places - seen.command[:, None], -seen.turn(yaws)[:, None])
    turn = lessons.yaws - seen.told[:, None]
    wanted = [away / PANDA.reach, turn[..., None] / PANDA.turn, lessons.grips[..., None]]
    return seen.features(yaws), np.concatenate(wanted, axis=-1).astype(np.float32)


def train(data: Path, out: Path, options: Any) -> dict[str, Any]:
    """Trains and writes a policy; what is worth noting.

    Args:
      options: with demonstrations, anonymous, noise, stray, steps, seed and device.
    """
    torch.manual_seed(options.seed)
    rng, device = np.random.default_rng(options.seed), torch.device(options.device)
    lessons = demonstrations(data, options.demonstrations, options.anonymous)
    yaws = piece_yaws()
    features, _ = lesson(lessons, options.noise, yaws, rng, options.stray)
    policy = Policy(features.shape[1])
    policy.mean[:] = torch.as_tensor(features.mean(0))
    policy.spread[:] = torch.as_tensor(features.std(0)).clamp_min(1e-2)
    policy.yaws[:] = torch.as_tensor(yaws)
    policy.to(device)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=RATE, weight_decay=1e-4)
    began, every = time.monotonic(), max(1, options.steps // 20)
    for step in range(options.steps):
        if step % FRESH == 0:
            x, target = (
                torch.as_tensor(rows).to(device)
                for rows in lesson(lessons, options.noise, yaws, rng, options.stray)
            )
        rate = RATE * 0.5 * (1 + np.cos(np.pi * step / options.steps)) + 1e-6
        for group in optimizer.param_groups:
            group["lr"] = rate
        pick = torch.randint(len(x), (BATCH,), device=device)
        told, truth = policy(x[pick]), target[pick]
        motion = nn.functional.l1_loss(told[..., :4], truth[..., :4])
        grip = nn.functional.binary_cross_entropy_with_logits(told[..., 4], truth[..., 4])
        optimizer.zero_grad()
        (motion + 0.1 * grip).backward()
        optimizer.step()
        if (step + 1) % every == 0:
            off = 1e3 * PANDA.reach * (told[..., :3] - truth[..., :3]).detach().abs().mean()
            line = {"step": step + 1, "mm": float(off), "grip": float(grip.detach())}
            print(json.dumps({**line, "seconds": round(time.monotonic() - began, 1)}), flush=True)
    sources = lessons.seen.source[:: len(lessons.seen.source) // len(lessons.numbers)]
    shares = np.bincount(sources, minlength=DEMONSTRATIONS) / len(sources)
    notes = {"demonstrations": len(lessons.numbers), "pairs": len(x), "noise": options.noise,
             "stray": options.stray, "anonymous": options.anonymous,
             "steps": options.steps, "seed": options.seed, "features": features.shape[1],
             "sources": shares.round(4).tolist()}  # fmt: skip
    save(policy, out, notes)
    return notes


def save(network: nn.Module, out: Path, notes: dict[str, Any]) -> None:
    """Weights and a manifest in a folder."""
    out.mkdir(parents=True, exist_ok=True)
    weights = {name: w.detach().cpu().contiguous() for name, w in network.state_dict().items()}
    save_file(weights, out / "weights.safetensors")
    (out / "manifest.json").write_text(json.dumps(notes, indent=1))


def load(folder: Path) -> tuple[Policy, dict[str, Any]]:
    """A policy and its manifest."""
    notes = read_json(folder / "manifest.json")
    policy = Policy(notes["features"])
    policy.load_state_dict(load_file(folder / "weights.safetensors"))
    return policy.eval(), notes
