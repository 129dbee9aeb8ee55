"""How a very long recording is handled: time and memory to load, replay and diagnose it.

    python tools/bench_long.py --out out/long    # 10 million rows, some ten minutes

A pendulum with a servo and undeclared Coulomb friction, sampled at 500 Hz: time, position and
control. Each step runs in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import from_source

FORMATS = ("npz", "parquet", "csv")


def scene() -> Any:
    """As declared."""
    from_source.register("mujoco")
    import mjcf_assets
    from orbisim import load_scene

    path = Path(mjcf_assets.__file__).parent / "servo_pendulum" / "scene.xml"
    return load_scene(path, trusted=True)


def generate(out: Path, rows: int) -> None:
    """Writes the recording in all formats."""
    declared = scene()
    from orbisim import Recording, make_backend
    from orbisim.effects import EffectInstance, add_effects

    true = add_effects(declared, [EffectInstance("coulomb_friction", "servo", {"torque": 0.03})])
    engine = make_backend("mujoco", true)
    clock = declared.model.opt.timestep * np.arange(rows)
    control = 0.6 * np.sin(2 * np.pi * 0.7 * clock) + 0.4 * np.sin(2 * np.pi * 1.93 * clock + 1)
    run = engine.rollout(engine.reset(1), control[None, :, None], sensors=False)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(rows)
    position = np.concatenate([[0.0], run.qpos[0, :-1, 0]]) + noise
    recording = Recording(clock, {"qpos/servo": position, "ctrl/servo": control})
    for suffix in FORMATS:
        recording.save(out / f"long.{suffix}")


def load(path: Path) -> str:
    """Reads the file."""
    from orbisim import Recording

    return f"{len(Recording.load(path)):,} rows"


def replayed(path: Path) -> str:
    """Free runs over windows of half a second."""
    from orbisim import replay

    found = replay(scene(), path)
    return f"{len(found.windows):,} windows, RMS {found.rms:.3g} rad"


def diagnosed(path: Path) -> str:
    """The whole diagnosis, without a report."""
    from orbisim import diagnose

    return diagnose(scene(), path, progress=False).sentence


def measured(work: Callable[[Path], str], path: Path) -> dict[str, Any]:
    """What it took, and how much memory the process had in use at most."""
    from_source.register("mujoco")
    clock, processor = time.perf_counter(), time.process_time()
    said = work(path)
    return {
        "what": f"{work.__name__} .{path.suffix[1:]}",
        "file_MB": round(path.stat().st_size / 1e6),
        "clock_s": round(time.perf_counter() - clock, 1),
        "processor_s": round(time.process_time() - processor, 1),
        "memory_MB": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "said": said,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rows", type=int, default=10_000_000)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    jobs = [(load, args.out / f"long.{suffix}") for suffix in FORMATS]
    jobs += [(work, args.out / "long.npz") for work in (replayed, diagnosed)]
    rows = []
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=fresh, max_tasks_per_child=1) as pool:
        pool.submit(generate, args.out, args.rows).result()
        print("| what | file, MB | clock, s | processor, s | memory, MB | |")
        print("| --- | --- | --- | --- | --- | --- |")
        for work, path in jobs:
            rows.append(pool.submit(measured, work, path).result())
            print("|", *(f"{value} |" for value in rows[-1].values()), flush=True)
    (args.out / "figures.json").write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
