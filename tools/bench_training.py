"""Training samples a second by number of GPUs, through `torchrun` as users start it.

    python tools/collect_all.py --out DATA --scale 0.02 --only push_train
    python tools/bench_training.py --data DATA/push_train.h5 --processes 1 2 --out training.json

A sample is one control step of one sequence, forward and backward. Every number of processes
trains the same model on the same batches, each process on its share (see `parallel`): the ratio
is what more GPUs bring to one training (strong scaling). After warming up, `--repeats` stretches of
`--steps` training steps are timed; the median counts, and all of them are written.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]


def main() -> int:
    """Starts one job after the other, or is one."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--processes", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--config", default="default")
    parser.add_argument("--length", type=int, default=8, help="control steps of a sequence")
    parser.add_argument("--batches", type=int, nargs="*", default=[2048, 8192], help="sequences")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--job", action="store_true", help="used by this tool itself")
    options = parser.parse_args()
    if options.job:
        job(options)
        return 0
    found: dict[str, Any] = {"options": {k: str(v) for k, v in vars(options).items()}}
    for batch in options.batches:
        for count in options.processes:
            part = options.out.with_suffix(f".{batch}.{count}.part")
            words = [*sys.argv, "--job", "--batches", str(batch), "--out", str(part)]
            runner = [sys.executable, "-m", "torch.distributed.run", f"--nproc-per-node={count}"]
            done = subprocess.run([*runner, *words], capture_output=True, text=True)
            if done.returncode or not part.exists():
                found[f"{batch} {count}"] = {"failed": done.stderr[-800:]}
            else:
                found[f"{batch} {count}"] = json.loads(part.read_text())
                part.unlink()
            one = found.get(f"{batch} {options.processes[0]}", {}).get("samples_per_s")
            row = found[f"{batch} {count}"]
            if one and "samples_per_s" in row:
                row["times_the_first"] = row["samples_per_s"] / one
            print(batch, count, json.dumps(row)[:300], flush=True)
            options.out.write_text(json.dumps(found, indent=1))
    return 0


def job(options: Any) -> None:
    """One process of one training."""
    from orbisim_world_model import parallel
    from orbisim_world_model.config import replaced
    from orbisim_world_model.packing import read_data
    from orbisim_world_model.presets import preset
    from orbisim_world_model.schedule import Clock
    from orbisim_world_model.trainer import Trainer

    device, batch = parallel.start(options.device), options.batches[0]
    stages = f"1x{options.length}x{batch}ar"
    config = replaced(preset(options.config), {"train.stages": stages})
    pack = read_data([options.data]).to(device)
    trainer = Trainer(pack, config, Clock(10**6, None))

    def waited() -> float:
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter()

    for _ in range(5):
        trainer.step()
    times = []
    for _ in range(options.repeats):
        began = waited()
        for _ in range(options.steps):
            trainer.step()
        times.append((waited() - began) / options.steps)
    rate = batch * options.length / statistics.median(times)
    if parallel.rank() == 0:
        name = torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"
        found = {"samples_per_s": rate, "step_ms": [t * 1e3 for t in times], "device": name}
        options.out.write_text(json.dumps({**found, "processes": parallel.size()}))
    parallel.stop()


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
