"""Open-loop errors on the measured tosses of a cube (`tools/import_measured.py`).

    python tools/eval_cube.py RECORDINGS --fit tuned --limit 300 --start ZOO/toss --out OUT
    python tools/eval_cube.py RECORDINGS --model learned:OUT --model hybrid:OUT2 [--json FILE]

RECORDINGS is the folder with `split.json` and the tosses. The first form trains: `tuned` fine-tunes
the checkpoint --start on the measured tosses, `hybrid` learns what MuJoCo's step leaves over. The
second measures models on the tosses that were held out, next to MuJoCo with three contacts: as
declared (its defaults), with the published friction, and tuned by a grid search on some of the
tosses for fitting; the last two with elliptic friction cones. Each toss starts from its first
measured state and runs free; errors are means over time and over the tosses.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

STEP, SUBSTEPS = 1 / 148, 10
HALF_SECOND = 74


class Contact(NamedTuple):
    """Sliding friction, time constant (s) and friction cone."""

    friction: float
    constant: float
    cone: str = "elliptic"


DECLARED, PUBLISHED = Contact(1.0, 0.02, "pyramidal"), Contact(0.18, 0.02)
GRID = [
    Contact(friction, constant)
    for friction in (0.16, 0.17, 0.18, 0.19, 0.2)
    for constant in (0.005, 0.01, 0.02, 0.03)
]
GRID_TOSSES = 80
CUBE = """
<mujoco model="contactnets_cube">
  <option timestep="{timestep!r}" integrator="implicitfast" cone="{cone}"/>
  <worldbody>
    <geom name="board" type="plane" size="3 3 0.1"/>
    <body name="cube" pos="0 0 0.0524">
      <freejoint name="cube"/>
      <inertial pos="0 0 0" mass="0.37" diaginertia="0.00081 0.00081 0.00081"/>
      <geom name="cube" type="box" size="0.0524 0.0524 0.0524" priority="1"
            friction="{friction} 0.005 0.0001" solref="{constant} 1"/>
    </body>
  </worldbody>
</mujoco>
"""
SETTINGS = {
    "tuned": (
        "default",
        {
            "model.layers": 3,
            "train.precision": "fp32",
            "train.noise": 0.003,
            "train.rate": 2e-4,
            "train.stages": "0.4x8x64arf,0.6x40x24arf",
        },
    ),
    "hybrid": (
        "hybrid",
        {"model.layers": 2, "train.precision": "fp32", "train.stages": "1x1x512"},
    ),
}


def main() -> int:
    """Trains or measures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--fit", choices=SETTINGS)
    parser.add_argument("--start", type=Path, help="checkpoint to fine-tune")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds of training")
    parser.add_argument("--count", type=int, help="train on so many tosses alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--model", action="append", default=[], help="learned:PATH or hybrid:PATH")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.fit:
        fit(options)
        return 0
    found = measure(options)
    print(json.dumps(found, indent=1))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    return 0


def scene(contact: Contact) -> str:
    """MJCF of the cube with a contact."""
    return CUBE.format(timestep=STEP / SUBSTEPS, **contact._asdict())


def packed(options: Any, tosses: list[str], contact: Contact, baseline: str = "none") -> Any:
    """Tosses as episodes of the cube with a contact."""
    from orbisim_world_model.packing import read_data

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cube.xml"
        path.write_text(scene(contact))
        paths = [options.recordings / toss for toss in tosses]
        return read_data(paths, scene=str(path), timestep=STEP, baseline=baseline)


def tuned(options: Any, tosses: list[str]) -> Contact:
    """The contact of the grid with the least mean position error."""
    pack = packed(options, tosses[:GRID_TOSSES], PUBLISHED)
    return min(GRID, key=lambda contact: _errors(pack, "mujoco", contact)["position_mm"])


def fit(options: Any) -> None:
    """Trains on the tosses for fitting; the checkpoint has its errors on the others."""
    from orbisim_world_model.config import replaced
    from orbisim_world_model.presets import preset
    from orbisim_world_model.run import Run, train

    name, settings = SETTINGS[options.fit]
    config = replaced(preset(name), settings)
    split = json.loads((options.recordings / "split.json").read_text())
    contact = tuned(options, split["fit"])
    fitted, held = (
        packed(options, tosses, contact, config.model.baseline)
        for tosses in (split["fit"][: options.count], split["held_out"])
    )
    run = Run(
        out=options.out,
        limit=options.limit,
        seed=options.seed,
        device=options.device,
        start=options.start,
        horizons=(10, 37, HALF_SECOND),
        burn=0,
        log_every=200,
    )
    train(fitted, config, run, lambda line: print(json.dumps(line), flush=True), held)


def measure(options: Any) -> dict[str, Any]:
    """Errors by model: mm and degrees, over all time and at half a second."""
    split = json.loads((options.recordings / "split.json").read_text())
    best = tuned(options, split["fit"])
    pack = packed(options, split["held_out"], best)
    rows = {"mujoco, declared": ("mujoco", DECLARED)}
    rows |= {"mujoco, published friction": ("mujoco", PUBLISHED), "mujoco, tuned": ("mujoco", best)}
    rows |= {model: (model, best) for model in options.model}
    errors = {label: _errors(pack, *row) for label, row in rows.items()}
    return {"tosses": pack.episodes, "tuned": best._asdict(), "errors": errors}


def _errors(pack: Any, name: str, contact: Contact) -> dict[str, float]:
    from orbisim import load_scene, make_backend
    from orbisim.state import State

    backend = make_backend(name, load_scene(scene(contact)))
    nstep = max(1, round(STEP / backend.timestep))
    longest = int(pack.length.max())
    start = pack.start.numpy()
    first = [a.double().numpy()[start] for a in (pack.qpos, pack.qvel, pack.act)]
    state = State(np.zeros(len(start)), *first)
    ran = backend.rollout(state, np.zeros((len(start), longest, 0)), nstep=nstep)
    found = []
    for number, length in enumerate(pack.length.tolist()):
        rows = slice(int(start[number]) + 1, int(start[number]) + length + 1)
        found.append(_apart(np.asarray(ran.qpos)[number, :length], pack.qpos[rows].numpy()))
    half = [(p[HALF_SECOND - 1], r[HALF_SECOND - 1]) for p, r in found if len(p) >= HALF_SECOND]
    over = [(p.mean(), r.mean()) for p, r in found]
    values = [*np.mean(over, axis=0), *np.mean(half, axis=0), *np.median(over, axis=0)]
    labels = ("position_mm", "rotation_deg", "position_mm_at_half_s", "rotation_deg_at_half_s")
    labels += ("median_position_mm", "median_rotation_deg")
    return {label: float(value) for label, value in zip(labels, values, strict=True)}


def _apart(ours: Any, measured: Any) -> tuple[Any, Any]:
    """Distance, mm, and angle, degrees, of poses [T, 7]."""
    distance = np.linalg.norm(ours[:, :3] - measured[:, :3], axis=1) * 1e3
    a, b = (torch.as_tensor(q[:, 3:]).double() for q in (ours, measured))
    inner = ((a / a.norm(dim=1, keepdim=True)) * (b / b.norm(dim=1, keepdim=True))).sum(1).abs()
    return distance, np.rad2deg(2.0 * np.arccos(np.minimum(inner.numpy(), 1.0)))


if __name__ == "__main__":
    sys.exit(main())
