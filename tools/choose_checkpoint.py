"""Of several checkpoints of one model of the suite, the one that errs least on held-out episodes.

    python tools/choose_checkpoint.py --data DATA --out BEST [--workers 16] CHECKPOINT...

DATA has `suite_NAME_calibration` of tools/collect_all.py: episodes that are neither trained on nor
those that figures are of, which a choice among many would make look better than they are. The score
is the geometric mean over domains of the median normalised error (see tools/eval_one_model.py)
after 50 of the suite's control steps. BEST gets a copy of the checkpoint with the least, the first
of those that are equal: name the one to beat first.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import math
import multiprocessing
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]


import train_all  # noqa: E402  (needs the path above)

from orbisim.tasks.domains import SUBSTEPS  # noqa: E402

MARK = 50
"""Control steps of the suite."""


def main() -> int:
    """Prints a line of JSON for each checkpoint, and which is the best."""
    options = _parser().parse_args()
    names = options.names.split(",")
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(options.workers, mp_context=context) as pool:
        jobs = [
            [pool.submit(error, folder, name, options.data) for name in names]
            for folder in options.checkpoints
        ]
        scores = []
        for folder, row in zip(options.checkpoints, jobs, strict=True):
            found = {name: one.result() for name, one in zip(names, row, strict=True)}
            scores.append(score(list(found.values())))
            print(json.dumps({"checkpoint": str(folder), "score": scores[-1], **found}), flush=True)
    best = options.checkpoints[scores.index(min(scores))]
    shutil.copytree(best, options.out, dirs_exist_ok=True)
    print(json.dumps({"best": str(best)}))
    return 0


def error(checkpoint: Path, name: str, data: Path) -> float:
    """Median normalised error of a checkpoint in a domain."""
    import torch
    from orbisim_world_model.checkpoint import load_for
    from orbisim_world_model.evaluate import evaluate
    from orbisim_world_model.packing import with_limbs

    torch.set_num_threads(1)
    (pack,) = train_all.read_named(data, (f"suite_{name}_calibration",))
    limbs, mark = with_limbs(pack), MARK * SUBSTEPS.get(name, 1)
    model = load_for(checkpoint, limbs.layout).model
    return float(evaluate(model, limbs, [mark], burn=0)[str(mark)]["normalised"]["median"])


def score(errors: list[float]) -> float:
    """Their geometric mean; infinite where one is not finite."""
    if not all(map(math.isfinite, errors)):
        return math.inf
    return math.exp(sum(math.log(max(value, 1e-12)) for value in errors) / len(errors))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoints", type=Path, nargs="+", metavar="CHECKPOINT")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--names", default="hopper,walker,cheetah,finger")
    parser.add_argument("--workers", type=int, default=1)
    return parser


if __name__ == "__main__":
    sys.exit(main())
