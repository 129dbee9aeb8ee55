"""`orbisim eval vision`: images of rollouts against the true ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from orbisim_diffusion.features import CLIP, Features, frechet_video_distance, perceptual_distance
from orbisim_diffusion.inference import StateInference
from orbisim_diffusion.model import Painter
from orbisim_diffusion.predictions import (
    RECORDED,
    Arrays,
    StateNoise,
    predict,
    with_predictions,
)
from orbisim_diffusion.pretrained import Pretrained
from orbisim_diffusion.quality import psnr, ssim
from orbisim_diffusion.store import Store, load
from orbisim_diffusion.trajectories import read_off, trajectory_errors, true_states
from orbisim_diffusion.workflows import Workflow, rollout

WORKFLOWS: tuple[Workflow, ...] = ("GT-first", "GT-state", "Recon-first", "Recon-all")
COPY = "copy first frame"
"""The baseline that shows nothing but the first image."""
MUJOCO, TRUE = "MuJoCo of predicted states", "true video"
"""MuJoCo's images of the states that the backend predicts, for a synthetic camera the best that
there can be; and what StaInf makes of the true video, the floor of TrajErr."""
HORIZONS = (10, 100)
_BATCH = 128
"""Episodes at a time."""


def evaluate(
    painter: Painter,
    path: Path,
    *,
    episodes: int = 200,
    workflows: Sequence[Workflow] = WORKFLOWS,
    steps: Sequence[int] = (1,),
    horizons: Sequence[int] = HORIZONS,
    features: Features | None = None,
    pretrained: Pretrained | None = None,
    inference: StateInference | None = None,
    mujoco: bool = False,
    predictions: Sequence[Arrays] = (),
    workers: int = 1,
    backend: str = "learned",
    noise: tuple[float, float] | None = None,
    seed: int = 0,
    report: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Quality of rollouts on the episodes of a file.

    Args:
      painter: the model. path: the file. episodes: at most so many, from its beginning.
      workflows: see `orbisim_diffusion.workflows`; GT-first and Recon-first use states that
        `backend` predicts from the first one.
      steps: of the sampler. horizons: frames over which figures are means.
      features: for EffNet-PD and EffNet-FVD; None leaves them out.
      pretrained: for LPIPS and FVD; None leaves them out.
      inference: StaInf, for TrajErr; None leaves it out.
      mujoco: whether MuJoCo's images of the predicted states are measured, too.
      predictions: of the file's episodes, if they were made before (with images for `mujoco`).
      workers: processes. backend: what predicts.
      noise: standard deviations, m and rad, of noise on states (`StateNoise`): on the first one,
        from which the backend predicts, and on each one that GT-state and Recon-all show. Images
        are held against the true ones. seed: of this noise, and of the sampler's.
      report: is told what was measured.

    Returns:
      By workflow and steps: PSNR, SSIM (EffNet-PD, LPIPS) by horizon, EffNet-FVD, FVD, TrajErr.
    """
    store = load([path], painter.device, workers=workers, limit=episodes)
    chosen = range(len(store.first))
    horizon = min(max(horizons), int(store.length.min()) - 1)
    predicted = store
    if mujoco or {"GT-first", "Recon-first"} & set(workflows):
        first = None if noise is None else StateNoise(*noise, seed=seed)
        made = predictions or predict(path, chosen, workers, backend, mujoco, first)
        predicted = with_predictions(store, made[: len(chosen)])
    true = _true(store, horizon)
    spans = sorted({min(h, horizon) for h in horizons})

    def scores(video: Tensor) -> dict[str, Any]:
        values: dict[str, Any] = _scores(video, true[:, 1:], spans, features, pretrained)
        if inference is not None:
            states, known = read_off(painter, inference, video), true_states(store, horizon)
            values |= trajectory_errors(states, known, len(video), store.step)
        return values

    found: dict[str, Any] = {COPY: scores(true[:, :1].expand_as(true[:, 1:]))}
    if inference is not None:
        found[TRUE] = scores(true[:, 1:])
    if mujoco:
        found[MUJOCO] = scores(_true(predicted, horizon)[:, 1:])
    for key, row in found.items():
        report(f"{path.name} {key}: {row}")
    predicted, shown = dataclasses.replace(predicted, frames=store.frames), store
    if noise is not None and {"GT-state", "Recon-all"} & set(workflows):
        each = StateNoise(*noise, every=True, seed=seed)
        shown = with_predictions(store, predict(path, chosen, workers, RECORDED, noise=each))
    for workflow in workflows:
        states = predicted if workflow in ("GT-first", "Recon-first") else shown
        for count in steps:
            parts = [
                rollout(painter, states, part, workflow, horizon, count, seed)
                for part in torch.arange(len(store.first), device=store.device).split(_BATCH)
            ]
            key = f"{workflow}, {count} steps"
            found[key] = scores(torch.cat(parts))
            report(f"{path.name} {key}: {found[key]}")
    return {"file": path.name, "episodes": len(store.first), "frames": horizon, "rows": found}


def _true(store: Store, horizon: int) -> Tensor:
    steps = torch.arange(horizon + 1, device=store.device)
    return store.frames[store.first[:, None] + steps]


def _scores(
    found: Tensor,
    true: Tensor,
    horizons: Sequence[int],
    features: Features | None,
    pretrained: Pretrained | None,
) -> dict[str, float]:
    """Means over episodes and over the frames of each horizon; videos are [E, T, H, W, 3]."""
    scores: dict[str, float] = {}
    for horizon in horizons:
        a, b = found[:, :horizon].flatten(0, 1), true[:, :horizon].flatten(0, 1)
        pairs = list(zip(a.split(256), b.split(256), strict=True))
        scores[f"PSNR{horizon}"] = float(torch.cat([psnr(*pair) for pair in pairs]).mean())
        scores[f"SSIM{horizon}"] = float(torch.cat([ssim(*pair) for pair in pairs]).mean())
        if features is not None:
            apart = torch.cat([perceptual_distance(features, *pair) for pair in pairs])
            scores[f"EffNet-PD{horizon}"] = float(apart.mean())
        if pretrained is not None and pretrained.lpips is not None:
            apart = torch.cat([pretrained.lpips(*pair) for pair in pairs])
            scores[f"LPIPS{horizon}"] = float(apart.mean())
    if found.shape[1] >= CLIP and len(found) > 1:
        if features is not None:
            scores["EffNet-FVD"], scores["clips"] = frechet_video_distance(features, found, true)
        if pretrained is not None and pretrained.i3d is not None:
            scores["FVD"], scores["clips"] = pretrained.i3d.distance(found, true)
    return {name: round(value, 4) for name, value in scores.items()}
