"""How long loading a scene takes, against plain MuJoCo, on robots with many meshes.

    python tools/bench_load.py --out out/bench_load.json [--repeats 5] [--only panda]

Each robot is loaded by `mujoco.MjModel.from_xml_path`, by `load_scene(trusted=True)` and by
`load_scene`, in turns, within one process; the first round is not counted ("a second time"). Of
each the least is taken, in processor time of all threads and of the child that tries a scene first,
so that other work on the machine hardly shows. The first load of a process
with an empty cache and with a filled one is reported beside it. The robots come from packages that
carry them (fetched into a cache folder; nothing enters the repository).
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
from corpora import unpacked

from orbisim import load_scene

ROBOTS = {
    "panda": ("robosuite", "robosuite/models/assets/robots/panda/robot.xml"),
    "sawyer": ("robosuite", "robosuite/models/assets/robots/sawyer/robot.xml"),
    "tiago": ("robosuite", "robosuite/models/assets/robots/tiago/robot.xml"),
    "gr1": ("robosuite", "robosuite/models/assets/robots/gr1/robot.xml"),
    "ur5e": ("robosuite", "robosuite/models/assets/robots/ur5e/robot.xml"),
    "baxter": ("robosuite", "robosuite/models/assets/robots/baxter/robot.xml"),
    "g1": ("mjlab", "mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml"),
    "yam": ("mjlab", "mjlab/asset_zoo/robots/i2rt_yam/xmls/yam.xml"),
    "fetch": ("gymnasium_robotics", "gymnasium_robotics/envs/assets/fetch/reach.xml"),
    "shadow_hand": ("gymnasium_robotics", "gymnasium_robotics/envs/assets/hand/reach.xml"),
}
GOALS = {"trusted": 1.3, "guarded": 2.0}


def main() -> int:
    """Writes JSON and prints a table; exit status 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/bench_load.json"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="orbisim-bench-")
    warnings.simplefilter("ignore")
    chosen = {name: where for name, where in ROBOTS.items() if options.only in name}
    rows = [measured(name, *where, options.repeats) for name, where in chosen.items()]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(rows, indent=1))
    print(markdown(rows))
    return int(
        any(row[kind] > goal * row["mujoco"] for row in rows for kind, goal in GOALS.items())
    )


def measured(name: str, package: str, file: str, repeats: int) -> dict[str, Any]:
    """Seconds for one robot."""
    path = str(unpacked(package) / file)
    fresh = [first_load(path) for _ in range(2)]  # the first one fills the cache
    ways: dict[str, Callable[[], Any]] = {
        "mujoco": lambda: mujoco.MjModel.from_xml_path(path),
        "trusted": lambda: load_scene(path, trusted=True),
        "guarded": lambda: load_scene(path),
    }
    times: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(1 + repeats):
        for way, load in ways.items():
            started = processor_time()
            load()
            times[way].append(processor_time() - started)
    best = {way: min(values[1:]) for way, values in times.items()}
    meshes = int(mujoco.MjModel.from_xml_path(path).nmesh)
    row = {"robot": name, "meshes": meshes, **best, "first": fresh[0], "first_cached": fresh[1]}
    print(row, file=sys.stderr, flush=True)
    return row


def processor_time() -> float:
    """Seconds of this process and of its children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def first_load(path: str) -> float:
    """Seconds for `load_scene` in a process of its own, imports not counted."""
    code = (
        "import sys, warnings; warnings.simplefilter('ignore')\n"
        "import os; from orbisim import load_scene, suite; load_scene('<mujoco/>')\n"
        "started = sum(os.times()[:4]); load_scene(sys.argv[1])\n"
        "print(sum(os.times()[:4]) - started)"
    )
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, check=True)
    return float(done.stdout.split()[-1])


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table of docs/benchmarks.md."""
    lines = [
        "| robot | meshes | MuJoCo (s) | trusted | otherwise | first load (s) "
        "| first load, cache filled (s) |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        ratios = " | ".join(f"{row[way] / row['mujoco']:.2f}" for way in ("trusted", "guarded"))
        lines.append(
            f"| {row['robot']} | {row['meshes']} | {row['mujoco']:.2f} | {ratios} "
            f"| {row['first']:.2f} | {row['first_cached']:.2f} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
