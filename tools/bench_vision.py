"""Speed of the diffusion renderer and of its training.

    python tools/bench_vision.py render [--checkpoint FOLDER] [--worlds 1 64] [--compiled] [--graph]
        [--out F]
    python tools/bench_vision.py train DATA.h5 [--checkpoint FOLDER] [--seconds 90] [--out FILE]

`render` compares with MuJoCo's renderer in this process. `train` takes a step of each network, as
it is and compiled, and casts rays.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import platform
import resource
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from orbisim_diffusion import edm
from orbisim_diffusion.autoencoder import autoencoder_loss, to_float
from orbisim_diffusion.checkpoint import Checkpoint, load_checkpoint
from orbisim_diffusion.config import DenoiserConfig
from orbisim_diffusion.loop import mixed
from orbisim_diffusion.store import Store, draw_frames, load
from orbisim_diffusion.training import draw_condition, encoded
from orbisim_diffusion.zoo import FOLDER

from orbisim import make_renderer
from orbisim.state import State
from orbisim.tasks.registry import make

_REPEATS = 21


def main() -> None:
    """Prints a line of JSON for each measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("what", choices=("render", "train"))
    parser.add_argument("data", type=Path, nargs="?", help="episodes with images, for `train`")
    parser.add_argument("--checkpoint", type=Path, default=FOLDER / "push")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 64])
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 4])
    parser.add_argument("--threads", type=int, default=0, help="of torch; 0 leaves them")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--seconds", type=float, default=120.0, help="no trial begins after")
    parser.add_argument("--compiled", action="store_true", help="`render`: rays are compiled")
    parser.add_argument("--graph", action="store_true", help="`render`: as a CUDA graph")
    parser.add_argument("--out", type=Path, help="a file for the lines, too")
    arguments = parser.parse_args()
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    trials = rendering(arguments) if arguments.what == "render" else training(arguments)
    lines = []
    for line in trials:
        lines.append(json.dumps(line))
        print(lines[-1], flush=True)
        if arguments.out:
            arguments.out.write_text("\n".join(lines) + "\n")


def _seconds(work: Callable[[], Any], device: torch.device, repeats: int = _REPEATS) -> list[float]:
    """Of each call, after seven that do not count."""
    found = []
    for number in range(repeats + 7):
        begun = time.perf_counter()
        work()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        if number > 6:
            found.append(time.perf_counter() - begun)
    return found


def _summary(found: list[float], frames: int) -> dict[str, float]:
    middle = statistics.median(found)
    return {
        "ms": round(1e3 * middle, 3),
        "ms_90": round(1e3 * sorted(found)[int(0.9 * len(found))], 3),
        "frames_per_s": round(frames / middle, 1),
    }


def rendering(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """MuJoCo's images in this process, then the model's of as many worlds at once."""
    scene = make("push").scene("to_hit", 0)
    device = torch.device(arguments.device)
    name = torch.cuda.get_device_name() if device.type == "cuda" else platform.processor()
    yield {"device": name, "threads": torch.get_num_threads()}
    look: dict[str, Any] = {"camera": "side", "height": 128, "width": 128}
    classical = make_renderer("mujoco", scene)
    one = _states(scene.model, 1)
    found = _seconds(lambda: classical.render(one, **look), torch.device("cpu"), 100)
    classical.close()
    yield {"renderer": "mujoco", "worlds": 1, **_summary(found, 1)}
    for worlds in arguments.worlds:
        states = _states(scene.model, worlds)
        for steps in arguments.steps:
            renderer = make_renderer(
                f"diffusion:{arguments.checkpoint}",
                scene,
                steps=steps,
                device=str(device),
                compiled=arguments.compiled,
                graph=arguments.graph,
            )
            if device.type == "cuda":
                torch.cuda.reset_peak_memory_stats(device)
            found = _seconds(lambda r=renderer, s=states: r.render_batch(s, **look), device)
            line = {"renderer": "diffusion", "worlds": worlds, "steps": steps}
            line |= {"compiled": arguments.compiled, "graph": arguments.graph}
            if device.type == "cuda":
                line["gigabytes"] = round(torch.cuda.max_memory_allocated(device) / 1e9, 2)
            else:  # of the whole process, Python and MuJoCo's renderer included
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
                line["resident_gigabytes"] = round(1024 * peak / 1e9, 2)
            yield {**line, **_summary(found, worlds)}


def _states(model: Any, worlds: int) -> State:
    rng = np.random.default_rng(0)
    qpos = np.tile(model.key_qpos[0], (worlds, 1))
    qpos[:, : model.nu] += rng.uniform(-0.1, 0.1, (worlds, model.nu))
    return State(
        np.arange(worlds) * 0.05, qpos, np.zeros((worlds, model.nv)), np.zeros((worlds, model.na))
    )


def training(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """A step of autoencoder and denoiser (0 to 6 context frames), and 64 views by ray casting."""
    begun = time.perf_counter()
    device = torch.device(arguments.device)
    point = load_checkpoint(arguments.checkpoint)
    store = load([arguments.data], device, limit=4)
    store = encoded(point.autoencoder.to(device), store)
    trials: list[tuple[str, Callable[[], Callable[[], Any]]]] = [
        ("rays", lambda: _rays(store, False)),
        ("autoencoder", lambda: _autoencoder(point, store, torch.channels_last, False)),
        ("denoiser", lambda: _denoiser(point, store, torch.channels_last, False)),
        ("rays, compiled", lambda: _rays(store, True)),
        ("autoencoder, compiled", lambda: _autoencoder(point, store, torch.channels_last, True)),
        ("autoencoder, rows", lambda: _autoencoder(point, store, torch.contiguous_format, False)),
        ("denoiser, rows", lambda: _denoiser(point, store, torch.contiguous_format, False)),
        ("denoiser, compiled", lambda: _denoiser(point, store, torch.channels_last, True)),
    ]
    for name, prepare in trials:
        if time.perf_counter() - begun > arguments.seconds:
            return
        started = time.perf_counter()
        try:
            found = _seconds(prepare(), device)
        except Exception as error:  # torch's compiler has errors of its own
            yield {"trial": name, "error": " ".join(str(error).split())[:300]}
            continue
        line = {"trial": name, **_summary(found, 1)}
        yield {**line, "first_s": round(time.perf_counter() - started - sum(found), 2)}


def _rays(store: Store, compiled: bool) -> Callable[[], Any]:
    made = dataclasses.replace(store, compiled=compiled)
    index = torch.randint(len(store), (64,), device=store.device)
    return lambda: made.conditions(index, DenoiserConfig())


def _autoencoder(
    point: Checkpoint, store: Store, layout: torch.memory_format, compiled: bool
) -> Callable[[], Any]:
    model = point.autoencoder.to(store.device, memory_format=layout).requires_grad_(True)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-6)
    measure = torch.compile(autoencoder_loss) if compiled else autoencoder_loss
    batch = min(point.config.train_autoencoder.batch, len(store))

    def step() -> None:
        index = torch.randint(len(store), (batch,), device=store.device)
        images = to_float(store.frames[index]).contiguous(memory_format=layout)
        with mixed(store.device):
            loss = measure(model, images)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return step


def _denoiser(
    point: Checkpoint, store: Store, layout: torch.memory_format, compiled: bool
) -> Callable[[], Any]:
    model = point.denoiser.to(store.device, memory_format=layout).requires_grad_(True)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-6)
    denoise = torch.compile(model) if compiled else model
    settings, batch = point.config.denoiser, point.config.train_denoiser.batch
    contexts = [3, 0, 1, 2, 4, 5, 6]
    drawn = [draw_frames(store, batch, count, settings.consecutive) for count in contexts]
    samples = itertools.cycle([draw_condition(store, point.config, frames) for frames in drawn])
    sigma = edm.draw_sigma(batch, settings.noise_mean, settings.noise_std, store.device)

    def step() -> None:
        given, target = next(samples)
        with mixed(store.device):
            denoised = denoise(target, sigma, given)
        loss = edm.denoising_loss(denoised, target, sigma, settings.sigma_data)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return step


if __name__ == "__main__":
    main()
