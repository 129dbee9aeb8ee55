"""Open-loop errors on the measured tosses of a cube (`tools/import_measured.py`).

    python tools/eval_cube.py RECORDINGS --fit tuned --limit 300 --start ZOO/toss --out OUT
    python tools/eval_cube.py RECORDINGS --model learned:OUT --model hybrid:OUT2 [--json FILE]

RECORDINGS is the folder with `split.json` and the tosses. The first form trains: `tuned` fine-tunes
the checkpoint --start on the measured tosses, `hybrid` learns what MuJoCo's step leaves over. The
second measures models on the tosses that were held out, next to MuJoCo with three contacts: as
declared (its defaults), with the published friction, and tuned by a grid search on some of the
tosses for fitting; the last two with elliptic friction cones. Each toss starts from its first
measured state and runs free; errors are means over time and over the tosses, and of the tosses'
means over time median, 90 % and worst.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import from_source  # noqa: E402  (needs the path above)

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
    "long": (
        "default",
        {
            "model.layers": 3,
            "loss.alignment": 0.0,
            "loss.consistency": 0.0,
            "train.precision": "fp32",
            "train.noise": 0.01,
            "train.rate": 3e-4,
            "train.decay": 1e-2,
            "train.stages": "0.3x12x512arf,0.7x48x512arf",
        },
    ),
    "hybrid": (
        "hybrid",
        {
            "model.layers": 2,
            "train.decay": 1e-2,
            "train.precision": "fp32",
            "train.stages": "1x1x2048",
        },
    ),
}
SPREAD = (0.0005, 0.005, 0.02, 0.2)
"""Noise of a state that hybrid training starts from: m, rad, m/s, rad/s; about the measured one."""


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
    parser.add_argument("--contact", help="friction,seconds that MuJoCo is tuned to; no search")
    parser.add_argument("--symmetric", action="store_true", help="see every toss in 48 ways")
    parser.add_argument("--copies", type=int, default=0, help="of each state, with noise (hybrid)")
    parser.add_argument("--compiled", action="store_true", help="training steps, by torch")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--model", action="append", default=[], help="learned:PATH or hybrid:PATH")
    parser.add_argument(
        "--diagnosed", type=Path, help="scene.xml of a diagnosis, stepped as the others are"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    from_source.register()
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
    """The contact of the grid with the least mean position error, or the one that is given."""
    if options.contact:
        return Contact(*map(float, options.contact.split(",")))
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
    baseline = config.model.baseline
    fitted = packed(options, split["fit"][: options.count], contact)
    held = packed(options, split["held_out"], contact, baseline)
    if baseline != "none":
        fitted = predicted(spread_out(fitted, options.copies, options.seed), contact)
    if options.symmetric:
        fitted = symmetric(fitted)
    run = Run(
        out=options.out,
        limit=options.limit,
        seed=options.seed,
        device=options.device,
        start=options.start,
        horizons=(10, 37, HALF_SECOND),
        burn=0,
        log_every=200,
        compiled=options.compiled,
    )
    train(fitted, config, run, lambda line: print(json.dumps(line), flush=True), held)


def symmetric(pack: Any) -> Any:
    """Every episode in the 48 ways in which a cube can be relabelled and mirrored.

    The cube looks the same after each of its 24 rotations, and a mirrored toss is a toss.
    """
    from orbisim_world_model.pack import joined

    rotations = torch.tensor(np.array(cube_rotations()), dtype=pack.qpos.dtype)
    seen = []
    for mirrored in (False, True):
        for rotation in rotations:
            qpos, qvel = relabelled(pack.qpos, pack.qvel, rotation, mirrored)
            base = pack.base
            if base.shape[1]:
                base = torch.cat(relabelled(base[:, :7], base[:, 7:], rotation, mirrored), 1)
            seen.append(dataclasses.replace(pack, qpos=qpos, qvel=qvel, base=base))
    return dataclasses.replace(joined(seen), notes=pack.notes, group=pack.group.repeat(len(seen)))


def relabelled(qpos: Any, qvel: Any, rotation: Any, mirrored: bool) -> tuple[Any, Any]:
    """States [F, 7] and [F, 6] of a cube turned by `rotation` [4], seen in a mirror across y.

    The angular velocity is in the body's frame.
    """
    from orbisim_world_model.rotation import conjugate, multiply

    if mirrored:
        qpos = qpos * torch.tensor([1.0, -1, 1, 1, -1, 1, -1])
        qvel = qvel * torch.tensor([1.0, -1, 1, -1, 1, -1])
    turn = rotation.expand(len(qpos), 4)
    pure = torch.cat([torch.zeros_like(qvel[:, :1]), qvel[:, 3:]], 1)
    local = multiply(conjugate(turn), multiply(pure, turn))[:, 1:]
    quat = multiply(qpos[:, 3:], turn)
    return torch.cat([qpos[:, :3], quat], 1), torch.cat([qvel[:, :3], local], 1)


def cube_rotations() -> list[Any]:
    """Unit quaternions of the 24 rotations of a cube."""
    basis = np.vstack([np.eye(4), np.array(np.meshgrid(*[[-0.5, 0.5]] * 4)).reshape(4, -1).T])
    for i in range(4):
        for j in range(i):
            for sign in (-1.0, 1.0):
                row = np.zeros(4)
                row[j], row[i] = 0.5**0.5, sign * 0.5**0.5
                basis = np.vstack([basis, row])
    first = [next(v for v in row if abs(v) > 1e-9) > 0 for row in basis]
    return [row for row, keep in zip(basis, first, strict=True) if keep]


def spread_out(pack: Any, copies: int, seed: int) -> Any:
    """Single steps: from each state, and from copies with noise, to the same next state."""
    from orbisim_world_model.rotation import exponential, multiply

    row, episode = pack.transitions(10**9)
    generator = torch.Generator().manual_seed(seed)
    starts, velocities = [], []
    for copy in range(copies + 1):
        size = float(copy > 0)
        noise = size * torch.randn(len(row), 12, generator=generator)
        at, turn, vel, ang = (n * s for n, s in zip(noise.split(3, 1), SPREAD, strict=True))
        qpos, qvel = pack.qpos[row], pack.qvel[row]
        quat = multiply(qpos[:, 3:], exponential(turn))
        starts.append(torch.cat([qpos[:, :3] + at, quat], 1))
        velocities.append(qvel + torch.cat([vel, ang], 1))

    def paired(first: Any, then: Any) -> Any:
        return torch.stack([torch.cat(first), then.repeat(copies + 1, 1)], 1).flatten(0, 1)

    count = len(row) * (copies + 1)
    episode = episode.repeat(copies + 1)
    empty = torch.zeros(2 * count, 0)
    return dataclasses.replace(
        pack,
        qpos=paired(starts, pack.qpos[row + 1]),
        qvel=paired(velocities, pack.qvel[row + 1]),
        **dict.fromkeys(("act", "ctrl", "action", "hand", "base"), empty),
        start=2 * torch.arange(count),
        length=torch.ones(count, dtype=torch.long),
        attributes=pack.attributes[episode],
        world=pack.world[episode],
        mask=pack.mask[episode],
        group=pack.group[episode],
    )


def predicted(pack: Any, contact: Contact) -> Any:
    """The pack with the step of MuJoCo with a contact."""
    from orbisim_world_model.baseline import with_baseline

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cube.xml"
        path.write_text(scene(contact))
        return with_baseline(pack, str(path))


def measure(options: Any) -> dict[str, Any]:
    """Errors by model: mm and degrees, over all time and at half a second."""
    split = json.loads((options.recordings / "split.json").read_text())
    best = tuned(options, split["fit"])
    pack = packed(options, split["held_out"], best)
    rows = {"mujoco, declared": ("mujoco", DECLARED)}
    rows |= {"mujoco, published friction": ("mujoco", PUBLISHED), "mujoco, tuned": ("mujoco", best)}
    rows |= {model: (model, best) for model in options.model}
    errors = {label: _errors(pack, *row) for label, row in rows.items()}
    if options.diagnosed:
        errors["mujoco, after diagnosis"] = _errors(pack, "mujoco", options.diagnosed)
    return {"tosses": pack.episodes, "tuned": best._asdict(), "errors": errors}


def _errors(pack: Any, name: str, contact: Contact | Path) -> dict[str, float]:
    from orbisim import Scene, load_scene, make_backend
    from orbisim.state import State

    where = str(contact) if isinstance(contact, Path) else scene(contact)
    loaded = load_scene(where)
    if isinstance(contact, Path):  # its own timestep may not divide a frame
        spec = loaded.spec
        spec.option.timestep = STEP / SUBSTEPS
        loaded = Scene.from_spec(spec, source=where)
    backend = make_backend(name, loaded)
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
    values += [*np.quantile(over, 0.9, axis=0), *np.max(over, axis=0)]
    labels = ("position_mm", "rotation_deg", "position_mm_at_half_s", "rotation_deg_at_half_s")
    labels += ("median_position_mm", "median_rotation_deg", "p90_position_mm", "p90_rotation_deg")
    labels += ("worst_position_mm", "worst_rotation_deg")
    return {label: float(value) for label, value in zip(labels, values, strict=True)}


def _apart(ours: Any, measured: Any) -> tuple[Any, Any]:
    """Distance, mm, and angle, degrees, of poses [T, 7]."""
    distance = np.linalg.norm(ours[:, :3] - measured[:, :3], axis=1) * 1e3
    a, b = (torch.as_tensor(q[:, 3:]).double() for q in (ours, measured))
    inner = ((a / a.norm(dim=1, keepdim=True)) * (b / b.norm(dim=1, keepdim=True))).sum(1).abs()
    return distance, np.rad2deg(2.0 * np.arccos(np.minimum(inner.numpy(), 1.0)))


if __name__ == "__main__":
    sys.exit(main())
