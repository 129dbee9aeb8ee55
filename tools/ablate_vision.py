"""Ablations of the denoiser, trained equally long on one frozen autoencoder.

    python tools/ablate_vision.py DATA.h5... --test test_push.h5 --seconds 600 --out DIR
        [--only default paper] [--checkpoint FOLDER] [--predictions FILE.npz]

The paper's by default; `--only default no_colour no_normals no_depth no_instance no_light` leaves
out the geometry buffers one by one. Each begins from nothing with the same seed and data; then come
rollouts of the test episodes. The autoencoder, and StaInf for TrajErr, are those of the checkpoint.
A line of JSON for each, and a checkpoint with the denoiser in DIR/NAME. With `--train-only` no
rollouts follow; where DIR/NAME is there already, it is measured as it is.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import torch
from orbisim_diffusion.checkpoint import (
    AUTOENCODER,
    DENOISER,
    MANIFEST,
    Checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from orbisim_diffusion.config import Buffer, Config, preset
from orbisim_diffusion.estimate import load_with_inference
from orbisim_diffusion.evaluate import evaluate
from orbisim_diffusion.features import Features
from orbisim_diffusion.inference import StateInference
from orbisim_diffusion.model import Painter
from orbisim_diffusion.predictions import predict, read_predictions, save_predictions
from orbisim_diffusion.store import load
from orbisim_diffusion.training import Run, encoded, train_denoiser
from orbisim_diffusion.zoo import FOLDER

from orbisim.tasks.dataset import EpisodeFile

NAMES = ("default", "no_decoupling", "no_random_sampling", "no_object_centric", "paper")
BUFFERS = tuple(f"no_{buffer}" for buffer in get_args(Buffer))


def main() -> None:
    """Trains and measures one after another; prints and writes a line of JSON for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, nargs="*", help="episodes with images")
    parser.add_argument("--test", type=Path, help="episodes that none is trained on")
    parser.add_argument("--train-only", action="store_true")
    parser.add_argument("--out", type=Path, required=True, help="folder for lines and checkpoints")
    parser.add_argument("--only", nargs="+", choices=(*NAMES, *BUFFERS), default=NAMES)
    parser.add_argument("--checkpoint", type=Path, default=FOLDER / "push")
    parser.add_argument("--seconds", type=float, default=600.0, help="of each training")
    parser.add_argument("--most-steps", type=int, help="of each training, at most")
    parser.add_argument("--batch", type=int, help="default: the configuration's")
    parser.add_argument("--episodes", type=int, default=20, help="of the test file")
    parser.add_argument("--steps", type=int, nargs="+", default=[4], help="of the sampler")
    parser.add_argument("--horizons", type=int, nargs="+", default=[10, 100], help="frames")
    parser.add_argument("--predictions", type=Path, help="file of predicted states, made if absent")
    parser.add_argument("--no-features", action="store_true", help="no EffNet-PD, EffNet-FVD")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes that read and predict")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    if arguments.test is None and not arguments.train_only:
        parser.error("--test is needed, unless --train-only is given")
    arguments.out.mkdir(parents=True, exist_ok=True)
    for line in ablations(arguments):
        text = json.dumps(line)
        print(text, flush=True)
        with (arguments.out / "ablations.jsonl").open("a") as file:
            file.write(text + "\n")


def ablations(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """What came out, for each."""
    begun, device = time.monotonic(), torch.device(arguments.device)
    point, inference = load_with_inference(arguments.checkpoint)
    autoencoder = point.autoencoder.to(device)
    left = [name for name in arguments.only if not (arguments.out / name / MANIFEST).exists()]
    plain = None
    if left:
        plain = encoded(autoencoder, load(arguments.data, device, workers=arguments.workers))
        yield {"episodes": len(plain.first), "frames": len(plain), "seconds": _since(begun)}
    known = [] if arguments.train_only else _predictions(arguments)
    features = None if arguments.no_features or arguments.train_only else Features(device)
    store, maps = plain, None
    for name in arguments.only:
        if name in left:
            config = _config(point, name, arguments.batch)
            assert plain is not None
            wanted: Any = config.denoiser.maps, config.denoiser.left_out
            if wanted != maps:
                maps, store = wanted, plain  # the old maps go before new ones come
                store = plain.with_maps(config.denoiser) if device.type == "cuda" else plain
            run = Run(arguments.seconds, arguments.most_steps, None, arguments.seed)
            assert store is not None
            model, loop = train_denoiser(config, run, store, lambda _: None)
            save_checkpoint(
                arguments.out / name,
                {AUTOENCODER: autoencoder, DENOISER: model},
                config,
                point.scope,
                {"metrics": {DENOISER: _spent(loop.history, loop.step)}},
            )
        trained = load_checkpoint(arguments.out / name)
        spent = {"name": name, "seed": arguments.seed, **trained.manifest["metrics"][DENOISER]}
        if arguments.train_only:
            yield {**spent, "seconds": _since(begun)}
            continue
        table = evaluate(
            Painter.of(trained, device),
            arguments.test,
            episodes=arguments.episodes,
            workflows=("GT-first",),
            steps=arguments.steps,
            horizons=arguments.horizons,
            features=features,
            inference=_on(inference, device),
            predictions=known,
            workers=arguments.workers,
            report=lambda _: None,
        )
        yield {**spent, **table, "seconds": _since(begun)}


def _config(point: Checkpoint, name: str, batch: int | None) -> Config:
    """The preset, for the checkpoint's autoencoder and images."""
    found = dataclasses.replace(
        preset(name), autoencoder=point.config.autoencoder, size=point.config.size
    )
    if batch is None:
        return found
    training = dataclasses.replace(found.train_denoiser, batch=batch)
    return dataclasses.replace(found, train_denoiser=training)


def _predictions(arguments: argparse.Namespace) -> Any:
    path = arguments.predictions or arguments.out / "predictions.npz"
    if not path.exists():
        made = predict(arguments.test, range(_count(arguments)), arguments.workers)
        save_predictions(path, made)
    return read_predictions(path)


def _count(arguments: argparse.Namespace) -> int:
    with EpisodeFile(arguments.test) as file:
        return min(len(file), arguments.episodes)


def _on(inference: StateInference | None, device: torch.device) -> StateInference | None:
    return None if inference is None else inference.to(device)


def _spent(history: list[dict[str, float]], steps: int) -> dict[str, float]:
    last = history[-1]
    return {
        "steps": steps,
        "loss": round(last["loss"], 5),
        "training_seconds": round(last["seconds"], 1),
    }


def _since(begun: float) -> float:
    return round(time.monotonic() - begun, 1)


if __name__ == "__main__":
    main()
