"""The training of StaInf on a store with latents of the frozen encoder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim_diffusion.checkpoint import INFERENCE, add_part, load_checkpoint
from orbisim_diffusion.config import Config, TrainConfig
from orbisim_diffusion.estimate import load_inference
from orbisim_diffusion.inference import (
    Inferred,
    StateInference,
    Truth,
    errors,
    inference_loss,
    robots,
    truth,
)
from orbisim_diffusion.loop import Kept, Loop, mixed
from orbisim_diffusion.measures import spread
from orbisim_diffusion.stills import SUFFIX, load_stills
from orbisim_diffusion.store import Store, load
from orbisim_diffusion.training import Run, encoded

TRAIN = TrainConfig(batch=512, rate=1e-3, warmup=200)
_SAME_VIEW = 1e-3
"""m, and of matrices' entries: cameras of collections that stand still differ by rounding only."""
_AGAIN = 0.5
"""Share of the highest rate for one that was trained before: at all of it a denoiser lost and
regained what it had (docs/trainings.md)."""
_NOISE = 0.1
"""Largest noise on latents in training: images that a model made are not quite true ones."""


def tune(
    folder: Path,
    data: Sequence[Path],
    held: Sequence[Path],
    run: Run,
    *,
    device: str = "cpu",
    workers: int = 1,
    start: Path | None = None,
    report: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Trains StaInf on the frozen encoder of a checkpoint and adds it there.

    Args:
      folder: of the checkpoint. data: episode files with images and a robot, or files of stills
        (`orbisim_diffusion.stills`). held: files to measure on; the data themselves if empty.
      run: see `Run`.
      device: where to compute. workers: processes that read.
      start: checkpoint whose StaInf is gone on with. report: is told how it goes.

    Returns:
      Errors on the held-out frames (see `orbisim_diffusion.inference.errors`).

    Raises:
      InputError: there is no checkpoint, episodes have no robot, or that of `start` reads latents
        of another encoder.
    """
    begun = None if start is None else _begun(start, folder)
    point, on = load_checkpoint(folder), torch.device(device)
    autoencoder = point.autoencoder.to(on)

    def seen(paths: Sequence[Path]) -> Store:
        store = encoded(autoencoder, _loaded(paths, on, workers))
        if "robot/qpos" not in store.extras:
            raise InputError(f"{paths[0]}: episodes of a robot's task are needed; it has no robot")
        return dataclasses.replace(store, frames=store.frames[:0])

    store = seen(data)
    test = seen(held) if held else store

    def kept(module: torch.nn.Module) -> None:
        add_part(folder, INFERENCE, module, {})

    model, loop = train_inference(point.config, run, store, report, kept, begun)
    metrics = {
        **inference_errors(model, test),
        "steps": loop.step,
        "seconds": round(loop.seconds, 1),
        "frames": len(store.episode),
    }
    add_part(folder, INFERENCE, model, metrics)
    return metrics


def _loaded(paths: Sequence[Path], device: torch.device, workers: int) -> Store:
    stills = [str(path).endswith(SUFFIX) for path in paths]
    if not any(stills):
        return load(paths, device, workers=workers)
    if not all(stills):
        raise InputError(
            f"{paths[stills.index(False)]}: episodes and stills are not mixed; give one kind"
        )
    return load_stills(paths, device)


def _begun(start: Path, folder: Path) -> StateInference:
    """StaInf of a checkpoint, if the encoder is the same."""
    point, model = load_inference(start)
    own = load_checkpoint(folder).autoencoder.state_dict()
    other = point.autoencoder.state_dict()
    if own.keys() != other.keys() or any(not torch.equal(own[n], other[n]) for n in own):
        raise InputError(f"{start}: its StaInf reads latents of another encoder than {folder}'s")
    return model


def train_inference(
    config: Config,
    run: Run,
    store: Store,
    report: Callable[[str], None] = print,
    kept: Kept | None = None,
    start: StateInference | None = None,
) -> tuple[StateInference, Loop]:
    """Trains StaInf; `store` has latents and a robot in every episode.

    Args:
      config: of the checkpoint. run: see `Run`. store: the data. report: is told how it goes.
      kept: see `orbisim_diffusion.loop.Kept`. start: trained before, to go on with.
    """
    torch.manual_seed(run.seed)
    model = start or StateInference(config.autoencoder.channels, config.size)
    model = model.to(store.device).requires_grad_(True)
    training = dataclasses.replace(TRAIN, rate=_AGAIN * TRAIN.rate) if start else TRAIN
    index = alike(store)
    model.look_from(store.view(index[:1]))
    loop = Loop(model, training, run.limit, run.progress, run.steps)
    robot, latents = robots(store), store.latents
    assert latents is not None
    batch = min(TRAIN.batch, len(index))

    def loss(_: int) -> Tensor:
        drawn = index[torch.randint(len(index), (batch,), device=store.device)]
        clean = latents[drawn].float()
        share = torch.rand(batch, 1, 1, 1, device=store.device) * _NOISE
        with mixed(store.device):
            found = model.dense(clean + share * torch.randn_like(clean))
        return inference_loss(model, found, truth(store, robot, drawn), store.view(drawn))

    loop.run(loss, report=report, kept=kept)
    average = loop.average
    assert isinstance(average, StateInference)
    return average, loop


def alike(store: Store) -> Tensor:
    """Numbers of the frames of the first frame's camera: from elsewhere, places look otherwise."""
    apart = (store.view_pos - store.view_pos[0]).norm(dim=-1)
    turned = (store.view_rot - store.view_rot[0]).abs().amax((1, 2))
    return ((apart < _SAME_VIEW) & (turned < _SAME_VIEW)).nonzero()[:, 0]


@torch.no_grad()  # type: ignore[untyped-decorator]
def inference_errors(model: StateInference, store: Store, count: int = 8192) -> dict[str, float]:
    """Errors on frames of a store with latents, spread over it."""
    assert store.latents is not None
    robot, found, true = robots(store), [], []
    chosen = alike(store)
    for index in chosen[spread(len(chosen), store.device, count)].split(1024):
        found.append(model(store.latents[index].float()))
        true.append(truth(store, robot, index))
    return errors(
        Inferred(*map(torch.cat, zip(*found, strict=True))),
        Truth(*map(torch.cat, zip(*true, strict=True))),
    )
