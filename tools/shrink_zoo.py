"""Writes checkpoints of learned dynamics, or of vision, again with few bits a weight.

    python tools/shrink_zoo.py --zoo ZOO --data DATA --out OUT [--only push,ball] [--bits 8]

DATA has some of what tools/collect_all.py collects for training; a twenty-fifth is enough
(`--scale 0.04`). Without, and for cloth and vision always, weights are rounded to the nearest.
Whether nothing is lost, tools/eval_dynamics.py --tails says of both folders, of cloth
tools/drape_metrics.py, and of vision `orbisim eval vision` or tools/bench_vision.py.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import train_all  # noqa: E402  (needs the path above)


def main() -> int:
    """Prints a line of JSON for each checkpoint."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--zoo", type=Path, required=True)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", help="names; all of the zoo by default")
    parser.add_argument("--bits", type=int, default=8)
    options = parser.parse_args()
    from orbisim_diffusion.checkpoint import SCHEMA as VISION
    from orbisim_diffusion.shrinking import shrink
    from orbisim_world_model.families import is_cloth
    from orbisim_world_model.shrinking import save_cloth_in_few_bits, save_in_few_bits

    from orbisim.files.reading import read_json

    known = sorted(path.parent.name for path in options.zoo.glob("*/manifest.json"))
    for name in options.only.split(",") if options.only else known:
        began, source, target = time.monotonic(), options.zoo / name, options.out / name
        shutil.copytree(source, target, dirs_exist_ok=True)
        if read_json(source / "manifest.json").get("schema") == VISION:
            shrink(source, target, options.bits)
        elif is_cloth(source):
            save_cloth_in_few_bits(source, target, options.bits)
        else:
            parts = tuple(f"{part}_train" for part in train_all.JOBS[name].data)
            packs = train_all.read_named(options.data, parts) if options.data else None
            save_in_few_bits(source, target, packs, options.bits)
        sizes = [
            sum(path.stat().st_size for path in folder.glob("*.safetensors"))
            for folder in (source, target)
        ]
        seconds = round(time.monotonic() - began)
        print(json.dumps({"name": name, "bytes": sizes, "seconds": seconds}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
