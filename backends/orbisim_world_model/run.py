"""`train`: a whole training, with saves, metrics, curves and a model card."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from orbisim.errors import InputError, OrbiSimError
from orbisim.files.locking import claimed
from orbisim.files.reading import parse_json
from orbisim.files.writing import check_folder, make_folder, output_errors, write_bytes
from orbisim.host.progress import patient
from orbisim.version import VERSION
from orbisim_world_model import parallel
from orbisim_world_model.card import write_card
from orbisim_world_model.checkpoint import WEIGHTS, load_for, ranges, save_checkpoint
from orbisim_world_model.config import Config
from orbisim_world_model.curves import draw_curves, drawable
from orbisim_world_model.evaluate import BURN, HORIZONS, constant_velocity, evaluate
from orbisim_world_model.manifest import MANIFEST
from orbisim_world_model.pack import Pack
from orbisim_world_model.progress_file import NAME as PROGRESS
from orbisim_world_model.progress_file import load_progress, save_progress
from orbisim_world_model.schedule import Clock
from orbisim_world_model.trainer import Trainer

METRICS = "metrics.jsonl"


@dataclasses.dataclass(frozen=True)
class Run:
    """What is asked of a training.

    Attributes:
      out: folder for checkpoint, metrics, curves and card.
      steps, limit: budgets in training steps and in seconds; at least one. The seconds are those
        of the whole run from `began` on: compiling counts, and the evaluation at the end gets a
        tenth of them, or a minute if that is less. It leaves out the longer horizons for which
        there is no time. What cannot be divided, the first step above all, may exceed them.
      most: further bound of the seconds, those of compiling not counted.
      seed: of everything random.
      device: `cpu`, `cuda`, `cuda:1`.
      held_out: share of the episodes that is kept for evaluation.
      save_every, log_every: seconds between saves, steps between lines of metrics.
      resume: go on with what stands in `out`.
      start: checkpoint whose weights are fine-tuned; of the configuration's model, only `rest` is
        taken, the others are the checkpoint's own.
      graph: run a training step as one CUDA graph.
      compiled: have torch compile what a training step computes (see `Trainer`).
      horizons, burn: of the evaluation.
      began: `time.monotonic()` at which the seconds start to count; when `train` is called if None.
    """

    out: Path
    steps: int | None = None
    limit: float | None = None
    most: float | None = None
    seed: int = 0
    device: str = "cpu"
    held_out: float = 0.1
    save_every: float = 60.0
    log_every: int = 50
    resume: bool = False
    start: Path | None = None
    graph: bool = True
    compiled: bool = False
    horizons: tuple[int, ...] = HORIZONS
    burn: int = BURN
    began: float | None = None


def train(
    packs: Pack | Sequence[Pack],
    config: Config,
    run: Run,
    report: Callable[[dict[str, Any]], None] = lambda _: None,
    held: Pack | Sequence[Pack] | None = None,
) -> dict[str, Any]:
    """Trains a model and leaves a checkpoint in `run.out`; returns its manifest.

    Args:
      packs: the data; one pack for each robot (see `pack.grouped`).
      config: of model and training.
      run: budgets, folders and the like.
      report: called with each line of metrics.
      held: episodes to evaluate on, in the same order; a part of each pack if None.

    Raises:
      InputError: no budget, or `out` cannot be written to or holds another training.
      OrbiSimError: the losses are no longer finite; what was saved before stays.
    """
    check_run(run)
    if run.began is None:
        run = dataclasses.replace(run, began=time.monotonic())
    device = parallel.start(run.device)
    with claimed_folder(run.out):
        return _train(_listed(packs), config, run, report, _listed(held), device)


def check_run(run: Run) -> None:
    """Checks what can be checked before data are read.

    Raises:
      InputError: no budget, or `out` cannot be written to or holds another training.
    """
    if run.steps is None and run.limit is None:
        raise InputError("a training needs a budget: give --steps, --time-limit or both")
    if not 0 <= run.held_out < 1:
        raise InputError(
            f"held_out is a share of the episodes, from 0 to below 1; got {run.held_out}"
        )
    check_folder(run.out)
    known = [name for name in (PROGRESS, WEIGHTS, MANIFEST) if (run.out / name).exists()]
    if known and not run.resume:
        raise InputError(
            f"{run.out}: holds a training already ({known[0]}); go on with it by --resume, or "
            "choose another --out"
        )


@contextlib.contextmanager
def claimed_folder(folder: Path) -> Iterator[None]:
    """Keeps other trainings out of a folder; among processes of one training, the first does."""
    if parallel.rank():
        yield
        return
    with claimed(make_folder(folder), "another training", "wait for it, or choose another --out"):
        yield


def _train(
    packs: list[Pack],
    config: Config,
    run: Run,
    report: Callable[[dict[str, Any]], None],
    held: list[Pack],
    device: Any,
) -> dict[str, Any]:
    kept, spare = _kept_and_held(packs, held, run, device)
    clock = Clock(run.steps, seconds_for_training(run), most=run.most)
    models = [load_for(run.start, p.layout).model for p in kept] if run.start else None
    for model in models or ():
        model.spread = None  # of a finished model alone is it known how far off it is
    if models and config.model.rest:
        models = [model.with_rest() for model in models]
    trainer = Trainer(
        kept,
        config,
        clock,
        seed=run.seed,
        models=models,
        graph=run.graph,
        compiled=run.compiled,
    )
    _resume(trainer, run)
    leads = parallel.rank() == 0
    if leads:
        begin_metrics(run.out / METRICS, clock.done)
    saved = time.monotonic()
    first = True
    while parallel.agreed(clock.progress, device) < 1.0:
        if first:
            with patient(f"the first training step on {device} takes longest"):
                trainer.step()
            first = False
        else:
            trainer.step()
        if clock.done % run.log_every == 0:
            _log(trainer, run, leads, report)
        if leads and time.monotonic() - saved > run.save_every:
            _save(trainer, run, None)
            saved = time.monotonic()
    _log(trainer, run, leads, report)
    manifest: dict[str, Any] = {}
    if leads:
        with patient("evaluating on held-out episodes"):
            manifest = _save(trainer, run, spare)
        draw_curves(run.out / METRICS, run.out / "curves.png")
        write_card(run.out, manifest)
    parallel.stop()
    return manifest


_MOST_EVALUATION = 60.0
"""Seconds of a limit that are kept for the evaluation at the end."""


def seconds_for_training(run: Run) -> float | None:
    """Seconds of the limit that are left for training."""
    if run.limit is None:
        return None
    assert run.began is not None
    kept = min(0.1 * run.limit, _MOST_EVALUATION)
    return max(run.limit - kept - (time.monotonic() - run.began), 1.0)


def _listed(packs: Pack | Sequence[Pack] | None) -> list[Pack]:
    if packs is None:
        return []
    return [packs] if isinstance(packs, Pack) else list(packs)


def _kept_and_held(
    packs: list[Pack], held: list[Pack], run: Run, device: Any
) -> tuple[list[Pack], list[Pack]]:
    """Training and evaluation episodes of each robot, on the device."""
    packs = [pack.to(device) for pack in packs]
    if not held:
        pairs = [pack.split(run.held_out) for pack in packs]
        return [kept for kept, _ in pairs], [spare for _, spare in pairs]
    robots = [[pack.layout.robot for pack in group] for group in (packs, held)]
    if robots[0] != robots[1]:
        raise InputError(f"training data of robots {robots[0]}, held-out data of {robots[1]}")
    return packs, [pack.to(device) for pack in held]


def begin_metrics(path: Path, done: int) -> None:
    """Leaves the lines of the steps that are done: later ones are written again."""
    kept = []
    for line in path.read_bytes().splitlines(keepends=True) if path.exists() else ():
        with contextlib.suppress(InputError):  # the last line, if the training was killed in it
            row = parse_json(line, str(path))
            if line.endswith(b"\n") and drawable(row) and row["step"] <= done:
                kept.append(line)
    write_bytes(path, b"".join(kept if done else ()), announce=False)


def _resume(trainer: Trainer, run: Run) -> None:
    found = load_progress(run.out) if run.resume else None
    if found is None:
        return  # killed before the first save: the same as a fresh start
    tensors, notes = found
    if notes["config"] != json.loads(json.dumps(trainer.config.to_dict())):
        raise InputError(f"{run.out}: was trained with another configuration; use another --out")
    if notes["seed"] != run.seed:
        raise InputError(f"{run.out}: was trained with --seed {notes['seed']}, not {run.seed}")
    shapes = {name: tensor.shape for name, tensor in trainer.optimizer.state().items()}
    if shapes != {name: tensor.shape for name, tensor in tensors.items()}:
        raise InputError(f"{run.out}: was trained on other data; use another --out")
    trainer.optimizer.restore(tensors)
    trainer.clock.done, trainer.clock.spent = notes["step"], notes["seconds"]


def _log(trainer: Trainer, run: Run, leads: bool, report: Callable[[dict[str, Any]], None]) -> None:
    losses = trainer.losses()
    if losses and not math.isfinite(losses["loss"]):
        raise OrbiSimError(
            f"training diverged: of the steps up to {trainer.clock.done} since the last line of "
            "metrics, none had a finite loss; lower train.rate, or look for numbers in the data "
            "that are out of all proportion"
        )
    if not (leads and losses):
        return
    line = {
        "step": trainer.clock.done,
        "seconds": round(trainer.clock.elapsed, 3),
        "rate": float(trainer.optimizer.rate),
        "ratio": float(trainer.ratio),
        **losses,
    }
    with output_errors(run.out / METRICS), (run.out / METRICS).open("a") as file:
        file.write(json.dumps(line) + "\n")
    report(line)


def _save(trainer: Trainer, run: Run, held: list[Pack] | None) -> dict[str, Any]:
    """Writes progress and checkpoint; with `held`, evaluates first."""
    clock, packs = trainer.clock, [part.pack for part in trainer.parts]
    pack = packs[0]
    save_progress(run.out, trainer.optimizer.state(), progress_of(trainer, run, clock))
    manifest: dict[str, Any] = {
        "config": trainer.config.to_dict(),
        "control_timestep": pack.layout.timestep,
        "ranges": ranges(pack),
        "data": {
            **_shapes_of(packs),
            **pack.notes,
            "groups": [name for part in packs for name in part.notes["groups"]],
            "sources": [source for part in packs for source in part.notes["sources"]],
            "episodes": sum(part.episodes for part in packs),
            "control_steps": sum(int(part.length.sum()) for part in packs),
        },
        "variants": [
            {"ranges": ranges(other), "robot": other.notes.get("robot", {})} for other in packs[1:]
        ],
        **origin_of(run, clock, trainer.device, trainer.precision, parallel.size()),
        "metrics": {},
    }
    save_checkpoint(run.out, trainer.models, manifest)
    if held is not None:
        found = [_metrics(run, part, trainer.config) for part in held]
        manifest["metrics"] = {**found[0], "variants": found[1:]}
        save_checkpoint(run.out, trainer.models, manifest)
    return json.loads((run.out / "manifest.json").read_text())


def _shapes_of(packs: list[Pack]) -> dict[str, Any]:
    """Which encoder the tokens of shapes are from, in whatever pack they are."""
    digests = {pack.notes["shapes"] for pack in packs if "shapes" in pack.notes}
    return {"shapes": digests.pop()} if digests else {}


def progress_of(trainer: Any, run: Run, clock: Clock) -> dict[str, Any]:
    """What a training that goes on must agree with, and how far it is."""
    return {
        "config": trainer.config.to_dict(),
        "seed": run.seed,
        "step": clock.done,
        "seconds": clock.elapsed,
    }


def origin_of(
    run: Run, clock: Clock, device: Any, precision: str, processes: int
) -> dict[str, Any]:
    """Of a manifest, how the model was trained and with which versions."""
    return {
        "training": {
            "steps": clock.done,
            "seconds": round(clock.elapsed, 1),
            "seed": run.seed,
            "device": device_name(device),
            "precision": precision,
            "processes": processes,
            "finished": clock.progress >= 1.0,
        },
        "versions": {"torch": torch.__version__, "orbisim": VERSION},
    }


def _metrics(run: Run, held: Pack, config: Config) -> dict[str, Any]:
    """Errors on held-out episodes of the checkpoint as it will be used, in fp16."""
    shipped = load_for(run.out, held.layout).model.to(held.device)
    still = constant_velocity(held, config.model)
    found: dict[str, Any] = {"model": {}, "constant_velocity": {}}
    left_out = []
    for horizon in sorted(run.horizons):
        if found["model"] and _late(run):
            left_out.append(horizon)
            continue
        for name, model in (("model", shipped), ("constant_velocity", still)):
            found[name] |= evaluate(model, held, (horizon,), burn=run.burn)
    more = {"horizons_left_out": left_out} if left_out else {}
    return {"held_out_episodes": held.episodes, "burn": run.burn, **found, **more}


def _late(run: Run) -> bool:
    """Whether the seconds of the whole run are over."""
    assert run.began is not None
    return run.limit is not None and time.monotonic() - run.began > run.limit


def device_name(device: Any) -> str:
    """What a manifest calls a device."""
    device = torch.device(device)
    return torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"
