"""Held-out errors of the checkpoints that a training kept on its way (`train_all.py --keep`).

    python tools/kept_errors.py WORK/push_fair_paper [...] --data push_test.h5 --out errors.json
        [--device cuda] [--horizon 100]

For each training a list of rows, one for each checkpoint in `NAME-kept/` and one for the last:
steps and seconds of training, and median, 90 % and worst over the episodes of every quantity at the
horizon, as `orbisim eval dynamics` has them. `tools/plot_curves.py --errors` draws them. Rows that
`errors.json` has are kept, so that it can be called again and again while a training goes on.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]


def main() -> None:
    """Evaluates one after another; the file is written again after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("trainings", type=Path, nargs="+", metavar="TRAINING")
    parser.add_argument("--data", type=Path, required=True, help="held-out episodes, .h5 or .pack")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--horizon", type=int, default=100, help="control steps")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    pack = _read(options.data).to(options.device)
    found: dict[str, list[dict[str, Any]]] = {}
    if options.out.exists():
        found = json.loads(options.out.read_text())
    for training in options.trainings:
        rows = found.setdefault(training.name, [])
        for folder in checkpoints(training):
            if steps(folder) in [known["steps"] for known in rows]:
                continue
            one = row(folder, pack, options.horizon)
            rows[:] = sorted([*rows, one], key=lambda each: each["steps"])
            options.out.write_text(json.dumps(found, indent=1))
            print(json.dumps({training.name: one}), flush=True)


def steps(folder: Path) -> int:
    """Of training, of a checkpoint."""
    return int(json.loads((folder / "manifest.json").read_text())["training"]["steps"])


def checkpoints(training: Path) -> list[Path]:
    """Those that were kept, in the order of their steps, and the last one."""
    kept = sorted(training.with_name(f"{training.name}-kept").glob("*/manifest.json"))
    last = [training] if (training / "manifest.json").exists() else []
    return [path.parent for path in kept] + last


def row(folder: Path, pack: Any, horizon: int) -> dict[str, Any]:
    """Steps, seconds and errors of one checkpoint."""
    from orbisim_world_model.checkpoint import load_for
    from orbisim_world_model.evaluate import evaluate

    training = json.loads((folder / "manifest.json").read_text())["training"]
    model = load_for(folder, pack.layout).model.to(pack.device)
    values = evaluate(model, pack, (horizon,))[str(horizon)]
    errors = {
        name: [one["median"], one["p90"], one["worst"]]
        for name, one in values.items()
        if isinstance(one, dict)
    }
    return {"steps": training["steps"], "seconds": training["seconds"], "errors": errors}


def _read(path: Path) -> Any:
    from orbisim_world_model.pack import Pack
    from orbisim_world_model.packing import read_data

    return Pack.load(path) if path.suffix == ".pack" else read_data([path])


if __name__ == "__main__":
    main()
