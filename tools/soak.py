"""Loads, steps and closes backends many times over, and records the memory that stays.

Usage:
  python tools/soak.py --cycles 20000 --out build/soak.json [--backends mujoco warp learned ...]

A cycle loads a scene into a new backend, steps it a few times and closes it. Resident memory is
read after every hundredth cycle, when garbage was collected; the slope over the second half of the
cycles (the first fills caches) says what stays, and that of what the C library has given out says
whether it is a leak or gaps between what was freed. `learned` uses a checkpoint of the zoo,
`compiled` the same with its step compiled to C, `hybrid` one that is made for the purpose.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

BACKENDS = ("mujoco", "warp", "learned", "compiled", "hybrid")
_EVERY = 100


def resident() -> int:
    """Resident memory of this process, bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmRSS:"))


class _Allocated(ctypes.Structure):
    """`struct mallinfo2` of glibc."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            "arena", "ordblks", "smblks", "hblks", "hblkhd",
            "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
        )
    )  # fmt: skip


def in_use() -> int:
    """Bytes that are allocated and not freed, by the C library (glibc 2.33 or later)."""
    told = ctypes.CDLL(None).mallinfo2
    told.restype = _Allocated
    found = told()
    return int(found.uordblks + found.hblkhd)


def cycle_of(name: str, folder: Path) -> Callable[[], None]:
    """One cycle of a backend."""
    import orbisim

    source = "suite:cartpole-swingup"
    if name == "hybrid":
        source, name = _hybrid(folder)
    scene = orbisim.load_scene(source)
    config: dict[str, Any] = {}
    if name not in ("mujoco", "warp"):
        config["native"] = name == "compiled"
    if name == "compiled":
        name = "learned"

    def cycle() -> None:
        engine = orbisim.make_backend(name, scene, device="cpu", **config)
        state = engine.reset()
        for _ in range(3):
            state = engine.step(state)
        engine.close()

    return cycle


def _hybrid(folder: Path) -> tuple[str, str]:
    """A scene and a hardly trained correction of it."""
    from orbisim_world_model.baseline import with_baseline
    from orbisim_world_model.run import Run, train

    from tests.backends.world_model.conftest import toy
    from tests.backends.world_model.synthetic import PENDULUM, simulate

    (folder / "scene.xml").write_text(PENDULUM)
    pack = with_baseline(simulate(PENDULUM, 4, 20, 2), str(folder / "scene.xml"))
    train(pack, toy("hybrid"), Run(out=folder / "checkpoint", steps=2, horizons=(1,), burn=0))
    return PENDULUM, f"hybrid:{folder / 'checkpoint'}"


def soak(name: str, cycles: int) -> dict[str, Any]:
    """Memory over the cycles of one backend."""
    with tempfile.TemporaryDirectory() as folder:
        cycle = cycle_of(name, Path(folder))
        numbers, sizes, used = [], [], []
        for number in range(1, cycles + 1):
            cycle()
            if number % _EVERY == 0 or number == cycles:
                gc.collect()
                numbers.append(number)
                sizes.append(resident())
                used.append(in_use())
    return {
        "backend": name,
        "cycles": cycles,
        "first_mb": round(sizes[0] / 2**20, 1),
        "last_mb": round(sizes[-1] / 2**20, 1),
        "slope_mb_per_1000_cycles": _slope(numbers, sizes),
        "in_use_slope_mb_per_1000_cycles": _slope(numbers, used),
    }


def _slope(numbers: list[int], sizes: list[int]) -> float:
    """Growth over the second half, MB per 1,000 cycles."""
    late = np.array(numbers) >= numbers[-1] / 2
    if sum(late) < 2:
        return 0.0
    found = np.polyfit(np.array(numbers)[late], np.array(sizes)[late], 1)[0]
    return round(float(found) * 1000 / 2**20, 3)


def main() -> int:
    """Runs the program."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=20_000, help="of all backends together")
    parser.add_argument("--backends", nargs="+", choices=BACKENDS, default=list(BACKENDS))
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in given.backends:
        rows.append(soak(name, given.cycles // len(given.backends)))
        print(json.dumps(rows[-1]), flush=True)
        given.out.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
