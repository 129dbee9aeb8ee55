"""`orbisim train vision`: the three trainings one after another, with checkpoints all the time."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import nn

from orbisim.errors import InputError
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.storage import versions
from orbisim_diffusion.checkpoint import (
    AUTOENCODER,
    DENOISER,
    INFERENCE,
    ONE_STEP,
    load_checkpoint,
    save_checkpoint,
)
from orbisim_diffusion.config import Config
from orbisim_diffusion.denoiser import Denoiser
from orbisim_diffusion.estimate import load_inference
from orbisim_diffusion.loop import Loop
from orbisim_diffusion.measures import reconstruction, single_frames
from orbisim_diffusion.model import Painter
from orbisim_diffusion.scope import read_scope
from orbisim_diffusion.store import Store, load
from orbisim_diffusion.training import (
    Run,
    encoded,
    train_autoencoder,
    train_denoiser,
    train_one_step,
)

COMPILED = ("rays", AUTOENCODER, DENOISER)
"""What can be compiled."""
_KEEP_MAPS = 0.65
"""Share of a GPU's memory that condition maps of all frames may take."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A training.

    Attributes:
      data: episode files with images. held: files to measure on; empty for none.
      out: folder of the checkpoint. limits: s of each part. device: where to compute.
      seed: of all random numbers. workers: processes that read. steps: at most so many steps of
        each part. resume: go on with the training that stands in `out`.
      start: checkpoint to begin from; a part whose limit is 0 stays as it is there.
      compiled: what torch compiles, of `COMPILED`.
    """

    data: tuple[Path, ...]
    held: tuple[Path, ...]
    out: Path
    limits: tuple[float, float, float]
    device: str = "cpu"
    seed: int = 0
    workers: int = 1
    steps: int | None = None
    resume: bool = False
    start: Path | None = None
    compiled: frozenset[str] = frozenset()


def train(config: Config, job: Job, report: Callable[[str], None] = print) -> dict[str, Any]:
    """Trains a vision model; from the autoencoder's end on there is a checkpoint in `job.out`.

    Args:
      config: of the model; that of `job.start` takes its place. job: what to do.
      report: is told how it goes.

    Returns:
      Its metrics on the held-out files.

    Raises:
      InputError: the data have no images, or another size than the configuration's; a part that
        is not trained has nothing to begin from.
    """
    device = torch.device(job.device)
    start = load_checkpoint(job.start) if job.start else None
    config = start.config if start else config
    if start is None and not (job.limits[0] > 0 and job.limits[1] > 0):
        raise InputError("autoencoder and denoiser must be trained, or come from --start")
    progress = job.out / "progress"
    if progress.exists() and not job.resume:
        raise InputError(f"{progress}: there is an unfinished training; --resume goes on with it")
    how: Any = {"workers": job.workers, "size": config.size}
    store = load(job.data, device, **how)
    held = load(job.held, device, limit=_HELD, **how) if job.held else store
    if store.size != config.size:
        raise InputError(f"images of {store.size} pixels; the configuration is for {config.size}")
    runs = [
        Run(limit, job.steps, progress / f"{name}.safetensors", job.seed, name in job.compiled)
        for name, limit in zip((AUTOENCODER, DENOISER, ONE_STEP), job.limits, strict=True)
    ]
    scope, notes = read_scope(store), _notes(job, store)
    metrics: dict[str, Any] = {}
    parts: dict[str, nn.Module] = {}
    store, held = (dataclasses.replace(s, compiled="rays" in job.compiled) for s in (store, held))

    def keep(name: str, module: nn.Module) -> None:
        parts[name] = module
        save_checkpoint(job.out, parts, config, scope, {**notes, "metrics": metrics})

    if job.limits[0] > 0:
        first = start.autoencoder if start else None
        autoencoder, loop = train_autoencoder(config, runs[0], store, report, first)
        metrics[AUTOENCODER] = _spent(loop)
    else:
        assert start is not None
        autoencoder = start.autoencoder.to(device)
        metrics[AUTOENCODER] = {}
        if INFERENCE in start.manifest["files"]:  # its encoder is the same
            parts[INFERENCE] = load_inference(start.path)[1]
            metrics[INFERENCE] = start.manifest.get("metrics", {}).get(INFERENCE, {})
    begun = start.denoiser if start else Denoiser(config.denoiser, config.autoencoder.channels)
    parts[AUTOENCODER] = autoencoder
    keep(DENOISER, begun)
    metrics[AUTOENCODER] |= reconstruction(autoencoder, held)
    report(f"autoencoder: {metrics[AUTOENCODER]}")
    store = _with_maps(encoded(autoencoder, store), config, report)
    metrics[DENOISER] = {}
    denoiser = begun.to(device)
    if job.limits[1] > 0:
        denoiser, loop = train_denoiser(
            config, runs[1], store, report, begun, lambda module: keep(DENOISER, module)
        )
        metrics[DENOISER] = _spent(loop)
    painter = Painter(autoencoder, denoiser, None, config, device)
    metrics[DENOISER] |= single_frames(painter, held)
    report(f"denoiser: {metrics[DENOISER]}")
    keep(DENOISER, denoiser)
    tuned = start.one_step.to(device) if start and start.one_step else None
    tuned = tuned if job.limits[0] == 0 else None  # else it is for another autoencoder
    if job.limits[2] > 0:
        one_step, loop = train_one_step(
            config,
            runs[2],
            store,
            autoencoder,
            tuned or denoiser,
            report,
            lambda module: keep(ONE_STEP, module),
        )
        painter = Painter(autoencoder, denoiser, one_step, config, device)
        metrics[ONE_STEP] = {**single_frames(painter, held, steps=(1,)), **_spent(loop)}
        report(f"one_step: {metrics[ONE_STEP]}")
        keep(ONE_STEP, one_step)
    elif tuned is not None:
        keep(ONE_STEP, tuned)
    return metrics


_HELD = 40
"""Episodes of each held-out file that a training is measured on as it goes."""


def _with_maps(store: Store, config: Config, report: Callable[[str], None]) -> Store:
    """Condition maps of all frames, where the device has the room."""
    if store.device.type != "cuda":
        return store
    one = store.conditions(torch.zeros(1, dtype=torch.long, device=store.device), config.denoiser)
    need = 2 * one[0].numel() * len(store)
    room = torch.cuda.mem_get_info(store.device)[0]
    if need > _KEEP_MAPS * room:
        report(f"condition maps of {need / 1e9:.0f} GB are computed as they are needed")
        return store
    return store.with_maps(config.denoiser)


def _spent(loop: Loop) -> dict[str, float]:
    return {"steps": loop.step, "seconds": round(loop.seconds, 1)}


def _notes(job: Job, store: Store) -> dict[str, Any]:
    sources = []
    for path in job.data:
        if path.is_dir():
            sources.append({"file": path.name, "task": "own recording", "episodes": 1})
            continue
        with EpisodeFile(path) as file:
            sources.append({"file": path.name, "task": file.task, "episodes": len(file)})
    name = torch.cuda.get_device_name() if store.device.type == "cuda" else "cpu"
    return {
        "data": {"sources": sources, "frames": len(store)},
        "training": {"seed": job.seed, "device": name, "cores": os.cpu_count()},
        "versions": {**versions(), "torch": torch.__version__},
    }
