"""Compares OrbiSim's URDF reader with MuJoCo's own import on the robots that packages ship.

Usage:
  python tools/corpus_urdf.py --out build/urdf_corpus [--cache DIR] [--folder DIR ...] [--only TEXT]

Fetches a few packages that carry robot descriptions (nothing of them enters the repository), reads
every `.urdf` in them, and writes `table.md` and `table.json`: does MuJoCo load the file (as it is,
or with its mesh names resolved for it), does OrbiSim, and how far apart are the two models.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from orbisim import load_scene
from orbisim.errors import OrbiSimError
from orbisim.scene.urdf.options import UrdfOptions
from orbisim.scene.urdf.packages import FileFinder

PACKAGES = {
    "example-robot-data": ("--only-binary", ":all:"),
    "icub-models": ("--only-binary", ":all:"),
    "hello-robot-stretch-urdf": ("--only-binary", ":all:"),
    "airo-models": ("--only-binary", ":all:"),
    "newton": ("--only-binary", ":all:"),
    "pybullet": ("--no-binary", ":all:", "--no-build-isolation"),
}
"""Package and how pip is to fetch it."""

SKIPPED = re.compile(r"random_urdfs/|/build/")
"""Nine hundred generated blocks that differ in nothing but their mesh."""

CONFIGURATIONS = 5


def fetch(cache: Path) -> list[Path]:
    """Downloads and unpacks the packages that are not there yet; returns their folders."""
    folders = []
    for name, how in PACKAGES.items():
        folder = cache / name
        folders.append(folder)
        if folder.is_dir():
            continue
        files = cache / f"{name}.download"
        files.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", *how]
        if subprocess.run([*command, "-d", str(files), name], check=False).returncode:
            print(f"cannot fetch {name}; left out", file=sys.stderr)
            continue
        for archive in files.iterdir():
            _unpack(archive, folder)
    return [folder for folder in folders if folder.is_dir()]


def _unpack(archive: Path, folder: Path) -> None:
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            wheel.extractall(folder)
    else:
        with tarfile.open(archive) as source:
            members = [m for m in source.getmembers() if "_data/" in m.name]
            source.extractall(folder, members, filter="data")


def load_with_mujoco(path: Path) -> tuple[mujoco.MjModel | None, str]:
    """MuJoCo's import of a file: as it is, or else with absolute mesh names."""
    text = path.read_bytes().decode("utf-8", errors="replace")
    try:
        return mujoco.MjSpec.from_file(str(path)).compile(), "as is"
    except (ValueError, mujoco.FatalError) as error:
        first = " ".join(str(error).split())
    try:
        return mujoco.MjSpec.from_string(_resolved(text, path)).compile(), "names resolved"
    except (ValueError, mujoco.FatalError) as error:
        return None, " ".join(str(error).split()) or first


def _resolved(text: str, path: Path) -> str:
    finder = FileFinder(path.parent, UrdfOptions(), str(path))

    def absolute(found: re.Match[str]) -> str:
        try:
            return f"{found[1]}{finder.find(found[2], 'mesh')}{found[3]}"
        except OrbiSimError:
            return found[0]

    return re.sub(r"(<mesh\b[^>]*?\bfilename\s*=\s*[\"'])([^\"']*)([\"'])", absolute, text)


def differences(ours: mujoco.MjModel, theirs: mujoco.MjModel, seed: int = 0) -> dict[str, float]:
    """Largest differences between two models of one robot, by quantity.

    Masses, centres of mass and tensors are relative to the largest of the model; positions are in
    m; axes, rotations and limits are absolute. NaN where a body or joint is missing in ours.
    """
    result = {
        "mass": _relative(_masses(ours, theirs)),
        "com": _largest(_per_body(ours, theirs, lambda m, b: m.body_ipos[b])),
        "inertia": _relative(_per_body(ours, theirs, _tensor)),
        "pos": _largest(_per_body(ours, theirs, lambda m, b: m.body_pos[b])),
        "axis": _largest(_per_joint(ours, theirs, lambda m, j: m.jnt_axis[j])),
        "anchor": _largest(_per_joint(ours, theirs, lambda m, j: m.jnt_pos[j])),
        "limits": _largest(_per_joint(ours, theirs, _limits)),
        "dynamics": _largest(_per_joint(ours, theirs, _dynamics)),
        "geoms": _largest(_geoms(ours, theirs)),
        "fk": _forward_kinematics(ours, theirs, np.random.default_rng(seed)),
    }
    same_order = _names(ours, "jnt") == _names(theirs, "jnt")
    return {**result, "order": 0.0 if same_order else 1.0}


Pairs = Iterator[tuple[np.ndarray[Any, Any], np.ndarray[Any, Any] | None]]


def _largest(pairs: Pairs) -> float:
    worst = 0.0
    for mine, other in pairs:
        if other is None or np.shape(mine) != np.shape(other):
            return float("nan")
        worst = max(worst, float(np.max(np.abs(np.subtract(mine, other)), initial=0.0)))
    return worst


def _relative(pairs: Pairs) -> float:
    collected = list(pairs)
    largest = max((float(np.max(np.abs(mine), initial=0.0)) for mine, _ in collected), default=0)
    return _largest(iter(collected)) / (largest or 1.0)


def _per_body(ours: Any, theirs: Any, value: Any) -> Pairs:
    for body in range(1, theirs.nbody):
        mine = mujoco.mj_name2id(ours, mujoco.mjtObj.mjOBJ_BODY, theirs.body(body).name)
        yield value(theirs, body), value(ours, mine) if mine >= 0 else None


def _masses(ours: Any, theirs: Any) -> Pairs:
    return _per_body(ours, theirs, lambda m, b: m.body_mass[b : b + 1])


def _tensor(model: Any, body: int) -> np.ndarray[Any, Any]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.body_iquat[body])
    axes = matrix.reshape(3, 3)
    return (axes * model.body_inertia[body]) @ axes.T


def _per_joint(ours: Any, theirs: Any, value: Any) -> Pairs:
    for joint in range(theirs.njnt):
        mine = mujoco.mj_name2id(ours, mujoco.mjtObj.mjOBJ_JOINT, theirs.jnt(joint).name)
        same = mine >= 0 and ours.jnt_type[mine] == theirs.jnt_type[joint]
        yield value(theirs, joint), value(ours, mine) if same else None


def _limits(model: Any, joint: int) -> np.ndarray[Any, Any]:
    span = model.jnt_range[joint] if model.jnt_limited[joint] else np.zeros(2)
    force = model.jnt_actfrcrange[joint] if model.jnt_actfrclimited[joint] else np.zeros(2)
    return np.concatenate([span, force, [float(model.jnt_limited[joint])]])


def _dynamics(model: Any, joint: int) -> np.ndarray[Any, Any]:
    dof = model.jnt_dofadr[joint]
    return np.array([model.dof_damping[dof], model.dof_frictionloss[dof]])


def _geoms(ours: Any, theirs: Any) -> Pairs:
    """Collision geoms of each body, in order: type, frame, size."""

    def collisions(model: Any, body: int) -> np.ndarray[Any, Any]:
        first = model.body_geomadr[body]
        rows = []
        for geom in range(first, first + model.body_geomnum[body]) if first >= 0 else ():
            if model.geom_contype[geom]:
                matrix = np.empty(9)
                mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
                kind = [float(model.geom_type[geom])]
                rows.append([*kind, *model.geom_pos[geom], *matrix, *model.geom_size[geom]])
        rows.sort(key=lambda row: [round(float(x), 6) + 0.0 for x in row])
        return np.array(rows).reshape(len(rows), 16)

    return _per_body(ours, theirs, collisions)


def _forward_kinematics(ours: Any, theirs: Any, rng: np.random.Generator) -> float:
    """Largest difference of body frames over random configurations, m or 1."""
    worst = 0.0
    for _ in range(CONFIGURATIONS):
        a, b = mujoco.MjData(ours), mujoco.MjData(theirs)
        for joint in range(theirs.njnt):
            mine = mujoco.mj_name2id(ours, mujoco.mjtObj.mjOBJ_JOINT, theirs.jnt(joint).name)
            if mine < 0:
                return float("nan")
            values = rng.uniform(-1.5, 1.5, theirs.jnt(joint).qpos0.size)
            b.qpos[theirs.jnt_qposadr[joint] :][: values.size] = values
            a.qpos[ours.jnt_qposadr[mine] :][: values.size] = values
        mujoco.mj_kinematics(ours, a)
        mujoco.mj_kinematics(theirs, b)
        for body in range(1, theirs.nbody):
            mine = mujoco.mj_name2id(ours, mujoco.mjtObj.mjOBJ_BODY, theirs.body(body).name)
            if mine < 0:
                return float("nan")
            gap = max(
                np.abs(a.xpos[mine] - b.xpos[body]).max(), np.abs(a.xmat[mine] - b.xmat[body]).max()
            )
            worst = max(worst, float(gap))
    return worst


def _names(model: Any, kind: str) -> list[str]:
    count = {"jnt": model.njnt}[kind]
    return [getattr(model, kind)(i).name for i in range(count)]


def examine(path: Path, name: str) -> dict[str, Any]:
    """One row of the table."""
    theirs, how = load_with_mujoco(path)
    row: dict[str, Any] = {"file": name, "mujoco": theirs is not None, "mujoco_note": how}
    try:
        scene = load_scene(path)
    except OrbiSimError as error:
        return {**row, "orbisim": False, "error": str(error)}
    row |= {"orbisim": True, "warnings": len(scene.warnings), "unsupported": len(scene.unsupported)}
    if theirs is not None:
        row["difference"] = differences(scene.model, theirs)
    return row


def markdown(rows: list[dict[str, Any]]) -> str:
    """The rows as a table, with a summary above it."""
    both = [row for row in rows if "difference" in row]
    keys = list(both[0]["difference"]) if both else []
    lines = [
        f"{len(rows)} files; MuJoCo loads {sum(r['mujoco'] for r in rows)}, "
        f"OrbiSim {sum(r['orbisim'] for r in rows)}, both {len(both)}.",
        "",
        f"| file | MuJoCo | OrbiSim | {' | '.join(keys)} | warnings | unsupported |",
        "| --- " * (len(keys) + 5) + "|",
    ]
    for row in rows:
        apart = row.get("difference")
        numbers = [f"{apart[key]:.1e}" for key in keys] if apart else ["" for _ in keys]
        ours = "yes" if row["orbisim"] else f"no: {row['error']}"
        theirs = row["mujoco_note"] if row["mujoco"] else f"no: {row['mujoco_note']}"
        counts = [str(row.get("warnings", "")), str(row.get("unsupported", ""))]
        cells = [row["file"], theirs, ours, *numbers, *counts]
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache/orbisim/corpus")
    parser.add_argument("--folder", type=Path, action="append", default=[])
    parser.add_argument("--only", default="", help="read only files whose path contains this")
    arguments = parser.parse_args()
    folders = arguments.folder or fetch(arguments.cache)
    rows = []
    for folder in folders:
        for path in sorted(folder.rglob("*.urdf")):
            name = str(path.relative_to(folder.parent))
            if arguments.only in name and not SKIPPED.search(name):
                rows.append(examine(path, name))
                state = "ok" if rows[-1]["orbisim"] else rows[-1]["error"]
                print(f"{len(rows)} {name}: {state}", file=sys.stderr, flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "table.json").write_text(json.dumps(rows, indent=1))
    (arguments.out / "table.md").write_text(markdown(rows))
    print(markdown(rows).splitlines()[0])
    return 0


if __name__ == "__main__":
    sys.exit(main())
