"""Trains the checkpoints of the zoo, and the models they are measured against, within a budget.

    python tools/train_all.py --data DATA --out OUT --time-limit 550 --only push,ball --device cuda

DATA holds what tools/collect_all.py wrote, or packs of it (tools/pack_data.py). The seconds are
shared among the jobs by weight. After each job, and while one runs, OUT has `summary.json`,
`table.md` and `checkpoints-0.tar`, `-1.tar` ... with the folders of the checkpoints; each file is
below 15 MB.
Training goes on in a folder of its own (--work), where --resume finds it. With --keep SECONDS the
checkpoint of every so many seconds stays beside it, as LABEL-kept/STEPS: tools/choose_checkpoint.py
finds the best of them, which need not be the last.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import shutil
import statistics
import sys
import tarfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from orbisim.tasks.domains import (  # noqa: E402  (needs the path above)
    HELD_OUT_MECHANISMS,
    MECHANISMS,
    SUBSTEPS,
    SUITE_DOMAINS,
)

LARGEST = 15 * 1024 * 1024
SHIPPED = ("model.safetensors", "manifest.json", "card.md", "metrics.jsonl", "curves.png")


@dataclasses.dataclass(frozen=True)
class Job:
    """One model.

    Attributes:
      data: names of the data files: `push` for `push_train` and, held out, `push_test`.
      config: preset. settings: changes to it.
      weight: share of the budget.
      horizons: of the evaluation, control steps.
      burn: control steps of true states before an evaluation.
      start: job whose checkpoint is fine-tuned.
    """

    data: tuple[str, ...]
    config: str = "default"
    settings: tuple[tuple[str, Any], ...] = ()
    weight: float = 1.0
    horizons: tuple[int, ...] = (10, 50, 100)
    burn: int = 8
    start: str = ""


_SMALL = (
    ("train.precision", "tf32"),
    ("train.stages", "0.4x1x8192,0.4x8x2048ar,0.2x32x2048arf"),
    ("model.layers", 3),
    ("train.noise", 0.01),
)
_EXACT = (
    ("train.precision", "fp32"),
    ("train.stages", "0.5x1x8192,0.2x8x2048ar,0.3x35x2048arf"),
    ("model.layers", 3),
    ("train.noise", 0.0),
)
"""For a motion whose bounces are resolved within the control step: noise would blur them."""
_TOUCH = (
    ("model.touch", True),
    ("model.layers", 3),
    ("loss.alignment", 0.0),
    ("loss.consistency", 0.0),
    ("train.noise", 0.003),
)
_LEGS = (
    *_TOUCH,
    ("model.width", 192),
    ("train.precision", "tf32"),
    ("train.stages", "0.4x1x2048,0.3x8x2048ar,0.3x25x2048arf"),
)
"""For legs that hit the ground: contact features, wider, less noise. One batch size for all stages,
so that torch compiles the losses once."""
_SMOOTH = (
    *_TOUCH,
    ("train.precision", "fp32"),
    ("train.stages", "0.4x1x2048,0.3x8x2048ar,0.3x32x2048arf"),
)
"""For motion that is smooth most of the time, where precision decides."""
_HOLDS = (
    ("model.rest", True),
    ("train.stages", "0.25x1x2048,0.35x8x2048ar,0.4x24x2048arf"),
)
"""For `push`, with data of rest, recovery and longer motion. One batch size, as above."""
_CONTACTS = (
    ("model.boxes", True),
    ("model.impulses", True),
    ("model.apart", True),
    *_HOLDS,
)
"""The same data and stages, with contacts from known geometry."""
_CLIPS = (
    *_CONTACTS[:-1],
    ("train.rate", 7e-4),
    ("train.stages", "0.55x8x2048arf,0.45x16x2048arf"),
)
"""After that, with `tools/collect_clips.py`: many short ones around contacts."""
_SHOVE = (
    *_CONTACTS[:-1],
    ("train.rate", 5e-4),
    ("train.stages", "0.4x8x1536arf,0.6x20x1536arf"),
)
"""After `push_contacts`: rollouts as long as the windows of an identification; no more states in a
step than `_CLIPS` has, which fit into the memory of one GPU."""
_TAIL = (
    ("model.rest", True),
    ("train.rate", 2e-4),
    ("train.stages", "0.35x32x1024arf,0.65x100x1024arf/25"),
)
"""After that: rollouts of a whole episode, gradients cut every 25 steps, at a low rate."""
_CUBES = (("train.stages", "0.35x1x8192,0.4x8x2048ar,0.25x24x1024arf"),)
"""Larger batches than usual: they are halved between the two robots."""
_TABLETOP = (
    ("model.rest", True),
    ("train.rate", 5e-4),
    ("train.stages", "0.35x8x1024arf,0.65x32x1024arf"),
)
"""After `cubes`: two more tasks in one model, and longer rollouts."""
_SUITE_SETTINGS = {
    "acrobot": _SMOOTH,
    "finger": _SMOOTH,
    **dict.fromkeys(("cheetah", "hopper", "walker"), _LEGS),
}
_SUITE_WEIGHTS = {"acrobot": 3.0, "finger": 3.0, "cheetah": 5.0, "hopper": 3.0, "walker": 6.0}
_MECHANISMS = tuple(f"mechanism_{f}" for f in MECHANISMS if f not in HELD_OUT_MECHANISMS)
_PARTS = (
    ("model.layers", 2),
    ("train.noise", 0.01),
    ("train.stages", "0.2x1x512,0.25x8x512ar,0.35x32x512arf,0.2x96x512arf/24"),
)
"""One batch size for all stages, so that torch compiles the losses once."""
_MIXED = (
    ("model.mixed", True),
    ("model.layers", 3),
    ("train.noise", 0.005),
    ("train.stages", "0.3x1x1536,0.35x8x1536ar,0.35x32x1536arf"),
)
"""Cubes with two robots and mechanisms in one model: a third of a batch is of each."""
_SMALL_PARTS = (
    ("model.width", 48),
    ("model.heads", 3),
    ("model.layers", 1),
    ("loss.alignment", 0.0),
    ("loss.consistency", 0.0),
    ("train.rate", 2e-3),
    ("train.stages", "0.6x1x256,0.4x10x32ar"),
)
"""For `mechanism_door` on one core of a CPU."""
_ONE = (
    ("model.width", 192),
    ("train.stages", "0.25x1x1024,0.35x8x1024ar,0.4x24x1024arf"),
)
"""One model of all the suite's robots. A step takes long, whatever the batch: kinematics and
impulses are many small operations. One batch size, so that torch compiles the losses once."""
_DRAPE = ("drape_primitives", "drape_meshes", "drape_unseen")
"""Of the last there are only episodes to measure on."""
_WIDE = (
    ("model.width", 128),
    ("train.stages", "0.15x1x512,0.45x8x128,0.4x30x48"),
)
"""For a GPU, which a batch of the presets leaves idle; longer sequences than they have."""
BASELINES = ("paper", "global", "dreamer")
_FAIR = (
    ("loss.scaled", True),
    ("train.noise", 0.03),
    ("train.stages", "0.3x16x512,0.4x36x256arw8,0.3x108x128arw8/36"),
)
"""For a comparison in which only models differ: one loss, in units of a step's change, one noise,
and windows up to an episode's length whose first 8 steps are ground truth, as in the evaluation."""
ABLATIONS = (
    "recurrent",
    "no_residual",
    "no_manifold",
    "no_relative",
    "no_contact",
    "no_noise",
    "no_alignment",
)
JOBS: dict[str, Job] = {
    "push": Job(("push", "push_hold"), settings=_HOLDS, weight=6.0),
    "push_contacts": Job(("push", "push_hold"), settings=_CONTACTS, weight=6.0),
    "push_clips": Job(
        ("push", "push_hold", "push_extra", "push_clips"),
        settings=_CLIPS,
        weight=6.0,
        start="push_contacts",
    ),
    "shove": Job(
        ("push", "push_hold", "shove", "shove_strikes", "shove_clips"),
        settings=_SHOVE,
        weight=6.0,
        horizons=(10, 20),
        burn=0,
        start="push_contacts",
    ),
    "push_tail": Job(
        ("push", "push_hold", "push_more", "push_long"), settings=_TAIL, weight=6.0, start="push"
    ),
    "cubes": Job(("push_cubes", "pick_and_place"), settings=_CUBES, weight=6.0),
    "tabletop": Job(
        ("push", "push_cubes", "pick_and_place", "stack"),
        settings=_TABLETOP,
        weight=6.0,
        horizons=(10, 100),
        start="cubes",
    ),
    "ball": Job(("ball", "ball_many"), settings=_EXACT, weight=4.0, horizons=(10, 20, 36), burn=0),
    "ball_500": Job(("ball",), settings=_EXACT, weight=2.0, horizons=(10, 20, 36), burn=0),
    "toss": Job(("toss",), settings=_SMALL, weight=4.0, burn=0),
    **{
        name: Job(
            (f"suite_{name}",),
            settings=_SUITE_SETTINGS.get(name, _SMALL),
            weight=_SUITE_WEIGHTS.get(name, 2.0),
            horizons=tuple(n * SUBSTEPS.get(name, 1) for n in (10, 50, 100, 1000)),
            burn=0,
        )
        for name in SUITE_DOMAINS
    },
    **{
        name.replace("parts", "mechanisms"): Job(
            _MECHANISMS, name, _PARTS, weight=4.0, horizons=(10, 100, 300), burn=0
        )
        for name in ("parts", "parts_no_memory", "parts_no_geometry", "parts_no_joints")
    },
    "suite_one": Job(
        tuple(f"suite_{name}" for name in SUITE_DOMAINS),
        "limbs",
        _ONE,
        weight=10.0,
        horizons=(10, 50, 100),
        burn=0,
    ),
    "one": Job(
        ("push", "push_cubes", "pick_and_place", "stack", *_MECHANISMS),
        "parts",
        _MIXED,
        weight=6.0,
        horizons=(10, 100),
        burn=0,
    ),
    "mechanism_door": Job(
        ("mechanism_door",), "parts_no_memory", _SMALL_PARTS, horizons=(10, 100, 300), burn=0
    ),
    **{
        name: Job(_DRAPE, name, _WIDE, weight=4.0)
        for name in ("cloth", "cloth_free", "cloth_shape")
    },
    **{
        f"push_{name}": Job(("push",), name, weight=2.0)
        for name in ("default", *BASELINES, *ABLATIONS)
    },
    **{
        f"push_fair_{name}": Job(("push",), name, settings=_FAIR, weight=2.0)
        for name in ("default", "recurrent", *BASELINES)
    },
}


def main() -> int:
    """Runs the chosen jobs."""
    options = _parser().parse_args()
    names = [name for name in options.only.split(",") if name]
    unknown = sorted(set(names) - set(JOBS))
    if unknown:
        print(f"unknown jobs {unknown}; there are {sorted(JOBS)}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    began, total = time.monotonic(), sum(JOBS[name].weight for name in names)
    left, failed = total, 0
    for name in names:
        remaining = options.time_limit - (time.monotonic() - began)
        budget = remaining * JOBS[name].weight / left - options.overhead
        left -= JOBS[name].weight
        for seed in range(options.seed, options.seed + options.seeds):
            label = name if options.seeds == 1 else f"{name}-s{seed}"
            try:
                _train(name, label, seed, max(budget / options.seeds, 1.0), options)
            except Exception as error:  # the other jobs still count
                failed += 1
                print(f"{label}: failed: {type(error).__name__}: {error}", flush=True)
            collect(options.work, options.out)
    return int(failed > 0)


def _train(name: str, label: str, seed: int, budget: float, options: Any) -> None:
    from orbisim_world_model.run import Run

    job, began = JOBS[name], time.monotonic()
    settings = {**dict(job.settings), **dict(text.split("=", 1) for text in options.set)}
    learn = _learner(job, settings, options.data)
    reading = time.monotonic() - began
    saved, kept = [time.monotonic()], [time.monotonic()]

    def report(line: dict[str, Any]) -> None:
        if options.keep is not None and time.monotonic() - kept[0] > options.keep:
            kept[0] = time.monotonic()
            _keep(options.work / label)
        if time.monotonic() - saved[0] > 60:
            saved[0] = time.monotonic()
            collect(options.work, options.out)
        more = {k: f"{line[k]:.4g}" for k in ("loss", "state_loss", "skipped") if k in line}
        said = " ".join(f"{k} {v}" for k, v in more.items())
        print(f"{label}: step {line['step']} {line['seconds']:.0f} s {said}", flush=True)

    run = Run(
        out=options.work / label,
        limit=max(budget - reading, 1.0) if options.steps is None else None,
        steps=options.steps,
        most=options.train_seconds,
        seed=seed,
        device=options.device,
        log_every=options.log_every,
        save_every=45.0,
        resume=options.resume,
        start=_start(job, name, options),
        compiled=options.compiled,
        graph=not options.no_graph,
        horizons=job.horizons,
        burn=job.burn,
    )
    manifest = learn(run, report)
    steps = manifest["training"]["steps"]
    total = time.monotonic() - began
    trained = manifest["training"]["seconds"]
    print(
        f"{label}: {steps} steps, {total:.0f} s: {reading:.0f} reading, {trained:.0f} training",
        flush=True,
    )
    for horizon, values in manifest["metrics"]["model"].items():
        medians = {k: round(v["median"], 4) for k, v in values.items() if isinstance(v, dict)}
        print(f"{label}: {horizon} steps: {medians}", flush=True)


def _keep(folder: Path) -> None:
    """Copies a training's checkpoint, as it was saved last."""
    if not (folder / "manifest.json").exists():
        return
    steps = json.loads((folder / "manifest.json").read_text())["training"]["steps"]
    target = folder.with_name(f"{folder.name}-kept") / f"{steps:06d}"
    target.mkdir(parents=True, exist_ok=True)
    for name in SHIPPED:
        if (folder / name).exists():
            shutil.copy(folder / name, target)


def _learner(job: Job, settings: dict[str, Any], folder: Path) -> Any:
    """What trains a job, given a run and a report; its data are read."""
    from orbisim_world_model.cloth.config import CLOTH_PRESETS, cloth_preset
    from orbisim_world_model.cloth.run import train_cloth
    from orbisim_world_model.config import replaced
    from orbisim_world_model.presets import preset
    from orbisim_world_model.run import train

    names = [tuple(f"{part}_{kind}" for part in job.data) for kind in ("train", "test")]
    if job.config in CLOTH_PRESETS:
        from orbisim_world_model.cloth.data import read_falls

        falls, held = (
            [path for name in each if (path := folder / f"{name}.h5").exists()] for each in names
        )
        config = cloth_preset(job.config, settings)
        seen, kept = read_falls(falls), read_falls(held) if held else None
        return lambda run, report: train_cloth(seen, config, run, report, kept)
    packs, spare = (read_named(folder, each) for each in names)
    assert packs, f"no data of {job.data}"
    wanted = replaced(preset(job.config), settings)
    if wanted.model.articulated:
        from orbisim_world_model.packing import limb_groups

        packs, spare = limb_groups(packs), limb_groups(spare)
    return lambda run, report: train(packs, wanted, run, report, spare or None)


def _start(job: Job, name: str, options: Any) -> Path | None:
    """The checkpoint whose weights are trained on; None for none."""
    if options.start is not None:
        return Path(options.start / name)
    return options.work / job.start if job.start else None


@functools.lru_cache(maxsize=2)
def read_named(folder: Path, names: tuple[str, ...]) -> list[Any]:
    """The data of these names, a pack for each robot; empty where there are none."""
    from orbisim_world_model.pack import Pack, grouped

    packs = []
    for name in names:
        pack, raw = folder / f"{name}.pack", folder / f"{name}.h5"
        if pack.exists():
            packs.append(Pack.load(pack))
        elif raw.exists():
            from orbisim_world_model.packing import read_data

            packs.append(read_data([raw]))
    return grouped(packs)


_SHOWN = (
    *("trajerr", "object_position", "object_rotation", "hand_position"),
    *("part_angle", "part_travel", "vertex_position", "normalised"),
)


def table(summary: dict[str, Any]) -> list[str]:
    """Held-out medians by job and horizon: the median over the seeds, and their range."""
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for label, entry in summary.items():
        metrics = entry.get("metrics") or {}
        for who in ("model", "constant_velocity"):
            job = label.rpartition("-s")[0] or label
            for horizon, values in metrics.get(who, {}).items():
                key = (job if who == "model" else f"{job}: constant velocity", horizon)
                rows.setdefault(key, []).append(values)
    lines = [f"| job | steps | seeds | {' | '.join(_SHOWN)} |", "| --- " * (3 + len(_SHOWN)) + "|"]
    for (job, horizon), found in rows.items():
        cells = [_spread([v[name]["median"] for v in found if name in v]) for name in _SHOWN]
        lines.append(f"| {job} | {horizon} | {len(found)} | {' | '.join(cells)} |")
    return lines


def _spread(values: list[float]) -> str:
    if not values:
        return ""
    middle = f"{statistics.median(values):.4g}"
    return middle if len(values) == 1 else f"{middle} ({min(values):.4g} to {max(values):.4g})"


def collect(work: Path, out: Path) -> None:
    """Puts the checkpoints into archives below the size limit, and their figures into a summary."""
    folders = sorted(path.parent for path in work.glob("*/manifest.json"))
    summary, bins, room = {}, [], 0
    for folder in folders:
        manifest = json.loads((folder / "manifest.json").read_text())
        summary[folder.name] = {
            key: manifest.get(key) for key in ("parameters", "training", "metrics")
        }
        size = sum((folder / name).stat().st_size for name in SHIPPED if (folder / name).exists())
        if not bins or room + size > LARGEST:
            bins.append([])
            room = 0
        bins[-1].append(folder)
        room += size
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    (out / "table.md").write_text("\n".join(table(summary)) + "\n")
    for number, chosen in enumerate(bins):
        part = out / f"checkpoints-{number}.part"
        with tarfile.open(part, "w") as archive:
            for folder in chosen:
                for name in SHIPPED:
                    if (folder / name).exists():
                        archive.add(folder / name, f"{folder.name}/{name}")
        part.replace(out / f"checkpoints-{number}.tar")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=Path("out/train_all"))
    parser.add_argument("--time-limit", type=float, required=True, help="seconds for everything")
    parser.add_argument("--only", default="push,cubes,ball,toss," + ",".join(SUITE_DOMAINS))
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--steps", type=int, help="instead of seconds, for rehearsals")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--train-seconds", type=float, help="a job at most, without compiling")
    parser.add_argument("--overhead", type=float, default=6.0, help="seconds a job for evaluation")
    parser.add_argument("--log-every", type=int, default=500)
    parser.add_argument("--keep", type=float, help="seconds between checkpoints that stay")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--start", type=Path, help="folder of checkpoints to go on from, by job")
    parser.add_argument("--compiled", action="store_true", help="training steps, by torch")
    parser.add_argument("--no-graph", action="store_true", help="no CUDA graphs; much slower")
    return parser


if __name__ == "__main__":
    sys.exit(main())
