"""Behaviour cloning of `task:stack` from images, judged in C MuJoCo.

    MUJOCO_GL=egl python tools/clone_stack_vision.py draw --data stack_train.h5 --out images \\
        --demonstrations 400 --workers 14
    python tools/clone_stack_vision.py train --images images --out clone_vision --device cuda
    MUJOCO_GL=egl python tools/clone_stack_vision.py eval --policy clone_vision --workers 14

As `tools/clone_stack.py`, but cubes are only seen: by two cameras (CAMERAS), 128 x 128 pixels, as
latents of the frozen autoencoder of `backends/orbisim_diffusion/zoo/push`. Cubes are red, green and
blue in their order, as an image says nothing else of which is which; where the tool is told to be,
fingers and grip are known as they are to the policy of states.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from safetensors.torch import load_file, save_file
from torch import nn

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

from clone_stack import (  # noqa: E402  (needs the path above)
    CHUNK,
    LARGEST,
    STEPS,
    Episode,
    demonstrations,
    joined,
)
from orbisim_diffusion.autoencoder import Autoencoder, to_float  # noqa: E402
from orbisim_diffusion.checkpoint import load_checkpoint  # noqa: E402
from orbisim_policies.evaluate import wilson  # noqa: E402

from orbisim.tasks import EpisodeFile  # noqa: E402
from orbisim.tasks.sampling import episode_seed  # noqa: E402
from orbisim.tasks.stack import Stack  # noqa: E402

ZOO = ROOT / "backends/orbisim_diffusion/zoo/push"
CAMERAS = ("side", "front")
SIZE = 128
EVERY = 5
"""Control steps between images of a demonstration."""
COLOURS = ((0.8, 0.2, 0.2), (0.2, 0.7, 0.2), (0.2, 0.3, 0.8))
OWN = 14
"""Numbers of `Seen.own`."""
BATCH, RATE = 256, 1e-3


class Eyes:
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


class VisionPolicy(nn.Module):
    """Latents [N, cameras * C, 16, 16] and own features [N, OWN] to actions [N, CHUNK, 5]."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.look = nn.Sequential(
            nn.Conv2d(channels, 64, 3, padding=1), nn.ELU(),
            nn.Conv2d(64, 64, 3, stride=2, padding=1), nn.ELU(),
            nn.Flatten(), nn.Linear(64 * 64, 256), nn.ELU(),
        )  # fmt: skip
        self.net = nn.Sequential(
            nn.Linear(256 + OWN, 512), nn.ELU(), nn.Linear(512, 512), nn.ELU(),
            nn.Linear(512, 5 * CHUNK),
        )  # fmt: skip

    def forward(self, latents: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
        """See the class."""
        found: torch.Tensor = self.net(torch.cat([self.look(latents), own], dim=1))
        return found.unflatten(-1, (CHUNK, 5))


def encoded(autoencoder: Autoencoder, images: npt.NDArray[np.uint8], device: Any) -> torch.Tensor:
    """[N, cameras * C, 16, 16] of images [N, cameras, SIZE, SIZE, 3]."""
    rows = []
    with torch.no_grad():
        for part in torch.as_tensor(images).split(128):
            latents = autoencoder.encode(to_float(part.to(device)).flatten(0, 1))
            rows.append(latents.unflatten(0, (len(part), len(CAMERAS))).flatten(1, 2))
    return torch.cat(rows)


# -- demonstrations ----------------------------------------------------------------------------


def drawn(path: Path, out: Path, index: int) -> int:
    """Images of one demonstration, every EVERY steps, in a file of their own."""
    target = out / f"images_{index:06d}.npy"
    if target.exists():
        return 0
    with EpisodeFile(path) as file:
        known = file.attributes(index)
        qpos = file.episode(index, ("qpos",))["qpos"]
    model = Stack().scene(known["subtask"], known["seed"]).model
    data, eyes = mujoco.MjData(model), Eyes(model)
    images = []
    for row in qpos[:-1:EVERY]:
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        images.append(eyes(data))
    eyes.close()
    part = target.with_suffix(".part.npy")
    np.save(part, np.array(images))
    part.replace(target)
    return len(images)


def draw(options: Any) -> None:
    """Draws demonstrations that succeed; what is drawn already stays."""
    options.out.mkdir(parents=True, exist_ok=True)
    with EpisodeFile(options.data) as file:
        every = range(len(file))
        good = [i for i in every if file.attributes(i)["success"]][: options.demonstrations]
    seen, action, count = demonstrations(options.data, options.demonstrations)
    rows = slice(None, None, EVERY)
    np.savez(options.out / "told.npz", own=seen.own()[rows], action=action[rows], numbers=good,
             episodes=count)  # fmt: skip
    began = time.monotonic()
    jobs = ([options.data] * len(good), [options.out] * len(good), good)
    with ProcessPoolExecutor(options.workers) as pool:
        total = sum(pool.map(drawn, *jobs, chunksize=4))
    print(json.dumps({"looks": total, "seconds": round(time.monotonic() - began, 1)}), flush=True)


def train(options: Any) -> dict[str, Any]:
    """Trains and writes a policy."""
    torch.manual_seed(options.seed)
    device = torch.device(options.device)
    told = np.load(options.images / "told.npz")
    autoencoder = load_checkpoint(ZOO).autoencoder.eval().to(device)
    files = [options.images / f"images_{number:06d}.npy" for number in told["numbers"]]
    x = torch.cat([encoded(autoencoder, np.load(path), device) for path in files])
    own = torch.as_tensor(told["own"]).float().to(device)
    action = told["action"]
    if len(x) != len(own):
        raise SystemExit(f"{options.images}: {len(x)} images of {len(own)} moments; draw again")
    wanted = action[..., [0, 1, 2, 5]] / LARGEST
    target = torch.as_tensor(np.concatenate([wanted, action[..., 6:] > 0], axis=-1))
    target = target.float().to(device)
    policy = VisionPolicy(x.shape[1]).to(device)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=RATE, weight_decay=1e-2)
    began, every = time.monotonic(), max(1, options.steps // 20)
    for step in range(options.steps):
        rate = RATE * 0.5 * (1 + np.cos(np.pi * step / options.steps)) + 1e-6
        for group in optimizer.param_groups:
            group["lr"] = rate
        pick = torch.randint(len(x), (BATCH,), device=device)
        found, truth = policy(x[pick], own[pick]), target[pick]
        motion = nn.functional.smooth_l1_loss(found[..., :4], truth[..., :4], beta=0.05)
        grip = nn.functional.binary_cross_entropy_with_logits(found[..., 4], truth[..., 4])
        optimizer.zero_grad()
        (motion + 0.1 * grip).backward()
        optimizer.step()
        if (step + 1) % every == 0:
            line = {"step": step + 1, "motion": float(motion.detach())}
            print(json.dumps({**line, "seconds": round(time.monotonic() - began, 1)}), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    weights = {n: w.detach().half().cpu().contiguous() for n, w in policy.state_dict().items()}
    save_file(weights, options.out / "policy.safetensors")
    notes = {"demonstrations": int(told["episodes"]), "looks": len(x), "steps": options.steps,
             "seed": options.seed, "channels": x.shape[1]}  # fmt: skip
    (options.out / "manifest.json").write_text(json.dumps(notes, indent=1))
    return notes


# -- in MuJoCo ---------------------------------------------------------------------------------


def play(folder: Path, seeds: list[int]) -> list[Any]:
    """(success, cubes stacked) of each episode."""
    torch.set_num_threads(1)
    notes = json.loads((folder / "manifest.json").read_text())
    policy = VisionPolicy(notes["channels"])
    tensors = load_file(folder / "policy.safetensors")
    policy.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    autoencoder = load_checkpoint(ZOO).autoencoder.eval()
    task, found = Stack(), []
    for seed in seeds:
        world = Episode(task, seed)
        eyes = Eyes(world.model)
        for _ in range(0, STEPS, CHUNK):
            x = encoded(autoencoder, eyes(world.data)[None], "cpu")
            own = torch.as_tensor(joined([world.seen()]).own())
            with torch.no_grad():
                told = policy(x, own)[0].double().numpy()
            actions = np.zeros((CHUNK, 7))
            actions[:, [0, 1, 2, 5]] = told[:, :4].clip(-1, 1) * LARGEST
            actions[:, 6] = np.where(told[:, 4] > 0, 1.0, -1.0)
            for action in actions:
                world.act(action)
        eyes.close()
        good = task.success("scripted", world.setting, np.array(world.path))
        found.append((bool(good), world.stacked))
    return found


def evaluate(options: Any) -> None:
    """Share of success, on the episodes that `clone_stack.py eval` has."""
    seeds = [episode_seed(options.seed, "stack", "clones", i) for i in range(options.episodes)]
    parts = [seeds[i :: options.workers] for i in range(options.workers)]
    with ProcessPoolExecutor(options.workers) as pool:
        played = list(pool.map(play, [options.policy] * len(parts), parts))
    each = [one for part in played for one in part]
    wins = sum(good for good, _ in each)
    result = {
        "policy": json.loads((options.policy / "manifest.json").read_text()),
        "episodes": len(each),
        "success": wins / len(each),
        "ci95": wilson(wins, len(each)),
        "first cube stacked": float(np.mean([count > 0 for _, count in each])),
    }
    print(json.dumps(result), flush=True)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="what", required=True)
    drawing = commands.add_parser("draw")
    drawing.add_argument("--data", type=Path, required=True)
    drawing.add_argument("--out", type=Path, required=True)
    drawing.add_argument("--demonstrations", type=int, default=400)
    drawing.add_argument("--workers", type=int, default=1)
    training = commands.add_parser("train")
    training.add_argument("--images", type=Path, required=True)
    training.add_argument("--out", type=Path, required=True)
    training.add_argument("--steps", type=int, default=6_000)
    training.add_argument("--device", default="cpu")
    training.add_argument("--seed", type=int, default=0)
    playing = commands.add_parser("eval")
    playing.add_argument("--policy", type=Path, required=True)
    playing.add_argument("--episodes", type=int, default=200)
    playing.add_argument("--workers", type=int, default=1)
    playing.add_argument("--seed", type=int, default=0)
    playing.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.what == "draw":
        draw(options)
    elif options.what == "train":
        print(json.dumps(train(options)))
    else:
        evaluate(options)


if __name__ == "__main__":
    main()
