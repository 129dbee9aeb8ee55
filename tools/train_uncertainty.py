"""Gives a finished checkpoint a calibrated uncertainty, and measures it.

    python tools/train_uncertainty.py --checkpoint CHECKPOINT --data FILES --held FILES
        --test FILES [--out FOLDER] [--ensemble 4]

The spread (see `orbisim_world_model.spread`) is trained on rollouts in FILES, calibrated on the
held-out ones, and measured on the test ones, none of which the others have. Rollouts are as long
as the longest episode of their file (`--length`: at most), and files take turns. FOLDER gets the
checkpoint with it. `--ensemble N` measures N decoders beside it, each trained anew on a frozen
trunk with batches of its own: their disagreement as the uncertainty, calibrated in the same way.

Printed as JSON, by horizon in control steps: `auroc` of "a cube is off by more than 5 cm or 20
degrees", the share of such cubes, and the coverage of 90 % intervals of position and rotation.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import json
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from orbisim_world_model.checkpoint import (  # noqa: E402  (needs the path above)
    WEIGHTS,
    load_checkpoint,
    write_parts,
)
from orbisim_world_model.pack import Pack, joined  # noqa: E402
from orbisim_world_model.packing import read_data  # noqa: E402
from orbisim_world_model.schedule import Clock  # noqa: E402
from orbisim_world_model.spread import FLOOR, UNITS, calibration_of  # noqa: E402
from orbisim_world_model.spread_fitting import (  # noqa: E402
    SpreadRun,
    deviations,
    factors,
    fit_spread,
    rollouts,
)

HORIZONS = (10, 50, 100)
FAR, TURNED = 0.05 / UNITS[0], 20.0
"""What counts as failed: 5 cm and 20 degrees, in the spread's units."""


def main() -> None:
    """Trains, measures, writes."""
    options = _parser().parse_args()
    checkpoint = load_checkpoint(options.checkpoint)
    train, held = (
        [_read([path], options) for path in paths] for paths in (options.data, options.held)
    )
    test = _read(options.test, options)
    model, began = checkpoint.model.to(options.device), time.monotonic()
    run = SpreadRun(
        steps=options.steps,
        limit=options.limit,
        finest=options.finest,
        windows=options.windows,
        length=options.length,
        seed=options.seed,
    )
    known = fit_spread(model, train, held, run)
    length = min(run.length or int(test.length.max()), int(test.length.max()))
    data = rollouts(model, test, length, options.test_windows, 99)
    with torch.no_grad():
        interval = deviations(model, data) * _factor(known, model, data)
    result = {"seconds": round(time.monotonic() - began, 1), **known}
    result["head"] = measured(interval, data.errors, data.mask)
    if options.out:
        _write(checkpoint, model, {**known, "test": result["head"]}, options.out)
    print(json.dumps(result), flush=True)
    if options.ensemble:
        result["ensemble"] = ensemble(checkpoint, train, held, data, options)
        print(json.dumps({"ensemble": result["ensemble"]}), flush=True)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


def measured(interval: Any, errors: Any, mask: Any) -> dict[str, Any]:
    """AUROC and coverage by horizon, from half-widths and errors [L, B, K, 2] of all entities."""
    result = {}
    for horizon in (*HORIZONS, len(errors)):
        if horizon > len(errors):
            continue
        there = mask[:, 1:] > 0
        error, width = errors[horizon - 1, :, 1:][there], interval[horizon - 1, :, 1:][there]
        failed = (error[:, 0] > FAR) | (error[:, 1] > TURNED)
        score = torch.maximum(width[:, 0] / FAR, width[:, 1] / TURNED)
        result[str(horizon)] = {
            "auroc": auroc(score.cpu().numpy(), failed.cpu().numpy()),
            "failed": float(failed.float().mean()),
            "coverage_position": float((error[:, 0] <= width[:, 0]).float().mean()),
            "coverage_rotation": float((error[:, 1] <= width[:, 1]).float().mean()),
            "coverage_hand": float(
                (errors[horizon - 1, :, 0, 0] <= interval[horizon - 1, :, 0, 0]).float().mean()
            ),
        }
    return result


def auroc(score: Any, positive: Any) -> float | None:
    """Chance that a positive has the higher score, ties counted half; None without both kinds."""
    many, few = int(positive.sum()), int((~positive).sum())
    if not many or not few:
        return None
    _, inverse, counts = np.unique(score, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    rank = (ends - (counts - 1) / 2)[inverse]
    return float((rank[positive].sum() - many * (many + 1) / 2) / (many * few))


def ensemble(
    checkpoint: Any, packs: list[Pack], held: list[Pack], test: Any, options: Any
) -> dict[str, Any]:
    """The same figures of the disagreement of decoders."""
    train = joined(packs)
    members = [_member(checkpoint, train, seed, options) for seed in range(options.ensemble)]
    length = test.control.shape[0]
    there = rollouts(checkpoint.model, held[0], length, 512, 98)
    known = {"factor": factors([(_disagreement(members, there), there)], 1)}
    interval = _disagreement(members, test) * _factor(known, checkpoint.model, test)
    return {
        **known,
        "members": options.ensemble,
        **measured(interval, test.errors, test.mask),
    }


def _member(checkpoint: Any, train: Pack, seed: int, options: Any) -> Any:
    """The model with a decoder of its own, trained on single steps for some seconds."""
    from orbisim_world_model.config import Config, Stage
    from orbisim_world_model.trainer import Trainer

    model = copy.deepcopy(checkpoint.model)
    model.spread = None
    model.requires_grad_(False)
    torch.manual_seed(seed)
    for layer in model.network.f_dec.modules():
        if isinstance(layer, torch.nn.Linear):
            layer.reset_parameters()
    model.network.f_dec.requires_grad_(True)
    config = Config.from_dict(checkpoint.manifest["config"])
    stages = (Stage(1.0, 1, options.member_batch),)
    config = dataclasses.replace(config, train=dataclasses.replace(config.train, stages=stages))
    steps = options.member_steps
    trainer = Trainer(train, config, Clock(steps, None), seed=seed, models=[model])
    while trainer.clock.progress < 1.0:
        trainer.step()
    return model.eval()


@torch.no_grad()  # type: ignore[untyped-decorator]
def _disagreement(members: Any, data: Any) -> Any:
    """[L, B, K, 2]: root mean square distance of the members' rollouts from the first one's."""
    from orbisim_world_model.entities import Entities
    from orbisim_world_model.spread import true_errors

    paths = []
    for model in members:
        x, memory, found = data.states.at(0), model.initial_memory(len(data.mask)), []
        for control in data.control:
            step = model(x, memory, control, data.context)
            x, memory = step.state, step.memory
            found.append(x)
        paths.append(Entities(*(torch.stack(f) for f in zip(*found, strict=True))))
    apart = [true_errors(p, paths[0], members[0].layout).square() for p in paths[1:]]
    return (torch.stack(apart).mean(0) + FLOOR**2).sqrt()


def _factor(known: dict[str, Any], model: Any, data: Any) -> Any:
    return calibration_of(known, model.layout).factors.to(data.errors.device)


def _write(checkpoint: Any, model: Any, known: dict[str, Any], out: Path) -> None:
    """The checkpoint with its spread; all other weights as they are stored, in few bits or not."""
    out.mkdir(parents=True, exist_ok=True)
    for name in ("card.md", "metrics.jsonl", "curves.png"):
        if (checkpoint.path / name).exists() and checkpoint.path != out:
            shutil.copy(checkpoint.path / name, out / name)
    stored = load_file(str(checkpoint.path / WEIGHTS))
    tensors = {name: tensor for name, tensor in stored.items() if not name.startswith("spread.")}
    for name, tensor in model.spread.state_dict().items():
        tensors[f"spread.{name}"] = tensor.detach().cpu().contiguous()
    manifest = {**checkpoint.manifest, "uncertainty": known, "parameters": _count(model)}
    write_parts(out, tensors, manifest)


def _count(model: Any) -> int:
    return sum(p.numel() for p in model.parameters())


def _read(paths: list[Path], options: Any) -> Pack:
    return read_data(paths).to(options.device)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--checkpoint", type=Path, required=True)
    for name in ("data", "held", "test"):
        parser.add_argument(f"--{name}", type=Path, nargs="+", required=True)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--limit", type=float, help="seconds of training at most")
    parser.add_argument("--finest", type=float, default=1e-3, help="see SpreadRun")
    parser.add_argument("--windows", type=int, default=6000)
    parser.add_argument("--test-windows", type=int, default=2048)
    parser.add_argument("--length", type=int, help="of rollouts, control steps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--ensemble", type=int, default=0)
    parser.add_argument("--member-steps", type=int, default=1500)
    parser.add_argument("--member-batch", type=int, default=8192)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    return parser


if __name__ == "__main__":
    main()
