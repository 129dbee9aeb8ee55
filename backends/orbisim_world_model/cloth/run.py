"""`train_cloth`: a whole training of a cloth, with saves, metrics, curves and a model card."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable
from typing import Any

from orbisim.errors import InputError, OrbiSimError
from orbisim.files.writing import output_errors
from orbisim_world_model.cloth.card import write_cloth_card
from orbisim_world_model.cloth.checkpoint import load_cloth, save_cloth
from orbisim_world_model.cloth.config import ClothConfig
from orbisim_world_model.cloth.data import Falls
from orbisim_world_model.cloth.evaluate import BASELINES, HORIZONS, baseline, evaluate_cloth
from orbisim_world_model.cloth.evaluate import strain as strain_of
from orbisim_world_model.cloth.fitting import cloth_properties
from orbisim_world_model.cloth.manifest import read_cloth_manifest
from orbisim_world_model.cloth.trainer import ClothTrainer
from orbisim_world_model.curves import draw_curves
from orbisim_world_model.progress_file import load_progress, save_progress
from orbisim_world_model.run import (
    METRICS,
    Run,
    begin_metrics,
    check_run,
    claimed_folder,
    origin_of,
    progress_of,
    seconds_for_training,
)
from orbisim_world_model.schedule import Clock


def train_cloth(
    falls: Falls,
    config: ClothConfig,
    run: Run,
    report: Callable[[dict[str, Any]], None] = lambda _: None,
    held: Falls | None = None,
) -> dict[str, Any]:
    """Trains a model and leaves a checkpoint in `run.out`; returns its manifest.

    Args:
      falls: the data. config: of model and training.
      run: budgets, folders and the like; `graph`, `compiled` and `burn` do not matter here.
      report: called with each line of metrics.
      held: episodes to evaluate on; a part of `falls` if None.

    Raises:
      InputError: no budget, nothing to train, or `out` cannot be written to or holds another
        training.
      OrbiSimError: the losses are no longer finite; what was saved before stays.
    """
    check_run(run)
    if config.model.kind not in ("graph", "shape"):
        raise InputError(f"model.kind is {config.model.kind!r}, of which nothing is learned")
    if run.began is None:
        run = dataclasses.replace(run, began=time.monotonic())
    with claimed_folder(run.out):
        falls = falls.to(run.device)
        kept, spare = (falls, held.to(run.device)) if held else falls.split(run.held_out)
        clock = Clock(run.steps, seconds_for_training(run), most=run.most)
        start = load_cloth(run.start, kept.mesh).model if run.start else None
        trainer = ClothTrainer(kept, config, run.seed, start)
        _resume(trainer, clock, run)
        begin_metrics(run.out / METRICS, clock.done)
        _descend(trainer, clock, run, report)
        manifest = _save(trainer, clock, run, spare)
        draw_curves(run.out / METRICS, run.out / "curves.png")
        write_cloth_card(run.out, manifest)
    return manifest


def _descend(
    trainer: ClothTrainer, clock: Clock, run: Run, report: Callable[[dict[str, Any]], None]
) -> None:
    saved, losses = time.monotonic(), []
    while clock.progress < 1.0:
        losses.append(trainer.step(clock.progress))
        clock.done += 1
        if clock.done % run.log_every == 0 or clock.progress >= 1.0:
            _log(clock, run, sum(losses) / len(losses), report)
            losses = []
        if time.monotonic() - saved > run.save_every:
            _save(trainer, clock, run, None)
            saved = time.monotonic()


def _log(clock: Clock, run: Run, loss: float, report: Callable[[dict[str, Any]], None]) -> None:
    if not math.isfinite(loss):
        raise OrbiSimError(
            f"training diverged at step {clock.done}: its loss is not finite; lower train.rate, or "
            "look for numbers in the data that are out of all proportion"
        )
    line = {"step": clock.done, "seconds": round(clock.elapsed, 3), "loss": loss}
    with output_errors(run.out / METRICS), (run.out / METRICS).open("a") as file:
        file.write(json.dumps(line) + "\n")
    report(line)


def _resume(trainer: ClothTrainer, clock: Clock, run: Run) -> None:
    found = load_progress(run.out) if run.resume else None
    if found is None:
        return
    tensors, notes = found
    if notes["config"] != json.loads(json.dumps(trainer.config.to_dict())):
        raise InputError(f"{run.out}: was trained with another configuration; use another --out")
    if notes["seed"] != run.seed:
        raise InputError(f"{run.out}: was trained with --seed {notes['seed']}, not {run.seed}")
    try:
        trainer.optimizer.restore(tensors)
    except (KeyError, RuntimeError):
        raise InputError(f"{run.out}: was trained on another cloth; use another --out") from None
    clock.done, clock.spent = notes["step"], notes["seconds"]
    trainer.done = clock.done


def _save(trainer: ClothTrainer, clock: Clock, run: Run, held: Falls | None) -> dict[str, Any]:
    """Writes progress and checkpoint; with `held`, evaluates what was written."""
    falls = trainer.falls
    save_progress(run.out, trainer.optimizer.state(), progress_of(trainer, run, clock))
    manifest: dict[str, Any] = {
        "config": trainer.config.to_dict(),
        "control_timestep": falls.mesh.timestep,
        "ranges": ranges(falls),
        "data": {
            **falls.notes,
            "episodes": falls.episodes,
            "control_steps": falls.episodes * falls.steps,
        },
        **origin_of(run, clock, run.device, "fp32", 1),
        "metrics": {},
    }
    save_cloth(run.out, trainer.model, manifest)
    if held is not None and held.episodes:
        shipped = load_cloth(run.out, held.mesh).model.to(run.device)
        manifest["metrics"] = measured(shipped, held)
        save_cloth(run.out, trainer.model, manifest)
    return read_cloth_manifest(run.out)


def measured(model: Any, held: Falls) -> dict[str, Any]:
    """The metrics of a manifest: a model's and the baselines' errors on held-out episodes."""
    found: dict[str, Any] = {"model": evaluate_cloth(model, held, HORIZONS)}
    for name in BASELINES:
        found[name] = evaluate_cloth(baseline(name, held.mesh), held, HORIZONS)
    return {"held_out_episodes": held.episodes, "groups": held.notes["groups"], **found}


def ranges(falls: Falls) -> dict[str, Any]:
    """What episodes cover (see `manifest.ClothRanges`)."""
    height, x = falls.x.pos[..., 2], falls.x
    return {
        **cloth_properties(falls.mesh, falls.solids),
        "height": [float(height.min()), float(height.max())],
        "speed": float(x.vel.norm(dim=-1).max()),
        "strain": max(float(strain_of(falls.mesh, one).max()) for one in x.pos),
    }
