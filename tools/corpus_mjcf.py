"""Loads every MJCF scene of the corpora and compares 1,000 steps with plain MuJoCo, bit for bit.

python tools/corpus_mjcf.py --out out/corpus_mjcf
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from corpora import mjcf_files

from orbisim import load_scene, make_backend
from orbisim.errors import SceneError
from orbisim.scene.scene import model_bytes
from orbisim.scene.tensors import from_tensors, to_tensors

STEPS = 1000


def main() -> int:
    """Runs over the corpora; exit status 1 if any scene that MuJoCo loads fails here."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/corpus_mjcf"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    rows = list(results())
    (out / "corpus_mjcf.json").write_text(json.dumps(rows, indent=1))
    table = markdown(rows)
    (out / "corpus_mjcf.md").write_text(table)
    print(table)
    return int(any(row["mujoco"] and not (row["loaded"] and row["equal"]) for row in rows))


def results() -> Iterator[dict[str, Any]]:
    """One row for each file."""
    for corpus, path in mjcf_files():
        row: dict[str, Any] = {"corpus": corpus, "file": path.name, "mujoco": False}
        row |= {
            "loaded": False,
            "equal": False,
            "identical": False,
            "editable": False,
            "tensors": False,
            "note": "",
        }
        try:
            plain = mujoco.MjModel.from_xml_path(str(path))
            row["mujoco"] = True
        except Exception as error:
            row["note"] = " ".join(str(error).split())[:100]
        try:
            scene = load_scene(path)
            row["loaded"] = True
        except SceneError as error:
            row["note"] = str(error)[:160]
        if row["mujoco"] and row["loaded"]:
            row["identical"] = model_bytes(plain) == model_bytes(scene.model)
            row["editable"] = model_bytes(scene.spec.compile()) == model_bytes(plain)
            row["equal"] = equal_steps(plain, scene)
            tensors = to_tensors(scene.descriptor)
            row["tensors"] = from_tensors(tensors, scene.descriptor) == scene.descriptor
        print(f"{corpus:20s} {path.name:40s} {row}", file=sys.stderr, flush=True)
        yield row


def equal_steps(plain: mujoco.MjModel, scene: Any) -> bool:
    """Whether `STEPS` steps with the same controls give the same bits, warnings included."""
    rng = np.random.default_rng(0)
    controls = rng.uniform(-1, 1, (STEPS, plain.nu))
    data = mujoco.MjData(plain)
    reference = np.full((STEPS, plain.nq + plain.nv), np.nan)
    for t in range(STEPS):
        data.ctrl[:] = controls[t]
        mujoco.mj_step(plain, data)
        if data.warning.number[3:].any():  # diverged: MuJoCo starts over
            break
        reference[t] = np.concatenate([data.qpos, data.qvel])
    backend = make_backend("mujoco", scene)
    trajectory = backend.rollout(backend.reset(), controls)
    ours = np.concatenate([trajectory.qpos[0], trajectory.qvel[0]], axis=1)
    return np.array_equal(ours, reference, equal_nan=True)


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table for docs/benchmarks.md."""
    lines = [
        "| corpus | XML files | MuJoCo loads | OrbiSim loads of these | same model bytes "
        "| the same after a round trip through the editable document "
        f"| {STEPS} steps equal bit for bit | descriptor to tensors and back |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for corpus in dict.fromkeys(row["corpus"] for row in rows):
        mine = [row for row in rows if row["corpus"] == corpus]
        good = [row for row in mine if row["mujoco"]]
        counts = [
            sum(row[key] for row in good)
            for key in ("loaded", "identical", "editable", "equal", "tensors")
        ]
        lines.append(f"| {corpus} | {len(mine)} | {len(good)} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
