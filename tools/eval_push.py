"""Errors and physics of learned steps on fresh episodes of `push`, beside C MuJoCo's.

    python tools/eval_push.py --data push_test.h5 --checkpoint CHECKPOINT [CHECKPOINT ...]
        [--episodes 200] [--device cuda] [--json FILE] [--mujoco MM ...]

Open loop over `--steps` control steps after 8 true ones. Printed as JSON, for each checkpoint:
  object_position (mm), object_rotation (deg), hand_position (mm) at the end: median, 90 % and worst
    over the episodes, a mean over the cubes of each; cube_* likewise over all cubes alone.
  penetration_mm: deepest overlap of two cubes (and of a cube with the hand's pads) in an episode,
    median, 95 % and worst; `mujoco` is the truth measured in the same way, by separating axes.
  energy: of cubes that move faster than 5 cm/s, the peak kinetic energy over the true peak: 5 %,
    median, 95 %, and the share within 20 %.
  ghosts: cubes that MuJoCo moves less than 1 mm and the model more than 5 mm.
With `--mujoco`, the same of C MuJoCo from starts in which cubes are off by a normal error of so
many mm along each axis of the table, and so many degrees about the vertical: what no model that is
as far off at its start can be expected to be below.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import collect_clips  # noqa: E402  (needs the path above)
from orbisim_world_model.boxes import separation  # noqa: E402
from orbisim_world_model.checkpoint import load_for  # noqa: E402
from orbisim_world_model.contacts import Contacts  # noqa: E402
from orbisim_world_model.entities import Context, Entities  # noqa: E402
from orbisim_world_model.pack import Pack, hands  # noqa: E402
from orbisim_world_model.packing import read_data  # noqa: E402
from orbisim_world_model.presets import preset  # noqa: E402
from orbisim_world_model.rotation import (  # noqa: E402
    conjugate,
    logarithm,
    multiply,
    rotate_back,
    to_matrix,
)
from orbisim_world_model.sampling import Batch, Windows  # noqa: E402
from orbisim_world_model.unroll import open_loop  # noqa: E402

from orbisim.tasks import assets  # noqa: E402

BURN = 8
MOVING, STILL, GHOST = 0.05, 1e-3, 5e-3
"""m/s, m, m: see above."""
WITHIN = 0.2


def main() -> None:
    """Rolls out and prints."""
    options = _parser().parse_args()
    pack = _read(options).to(options.device)
    result: dict[str, Any] = {"episodes": pack.episodes, "steps": options.steps}
    for folder in options.checkpoint:
        model = load_for(folder, pack.layout).model.to(options.device).eval()
        result[str(folder)] = figures(model, pack, options.steps)
        print(json.dumps({str(folder): result[str(folder)]}), flush=True)
    for off in options.mujoco:
        name = f"mujoco, off by {off:g} mm"
        result[name] = floor(pack.to("cpu"), options.steps, off)
        print(json.dumps({name: result[name]}), flush=True)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


def figures(model: Any, pack: Pack, steps: int) -> dict[str, Any]:
    """Everything that is printed of one model."""
    batch = _episodes(model.config, pack, steps)
    found = open_loop(model, batch, BURN)
    truth = Entities(*(field[BURN + 1 :] for field in batch.states))
    return compared(found, _completed(model, truth), batch, pack)


def compared(found: Entities, truth: Entities, batch: Batch, pack: Pack) -> dict[str, Any]:
    """The figures of states [L, B, ...] beside true ones."""
    place = (found.pos - truth.pos).norm(dim=-1)[-1] * 1e3  # [B, N]
    turn = _angle(found.quat, truth.quat)[-1]
    hand = (found.hand_pos - truth.hand_pos).norm(dim=-1)[-1] * 1e3
    return {
        "object_position": _row(place.mean(1)),
        "object_rotation": _row(turn.mean(1)),
        "cube_position": _row(place),
        "cube_rotation": _row(turn),
        "hand_position": _row(hand),
        "penetration_mm": {
            "model": penetration(found, batch.context, pack),
            "mujoco": penetration(truth, batch.context, pack),
        },
        "energy": energies(found, truth, batch.context, pack),
        "ghosts": ghosts(found, truth, batch.states.at(BURN)),
        "cubes": place.numel(),
    }


def floor(pack: Pack, steps: int, off: float) -> dict[str, Any]:
    """The figures of C MuJoCo from starts that are off by so many mm and degrees."""
    config, layout = preset("default").model, pack.layout
    qpos, qvel = simulated(pack, steps, off)
    moved = dataclasses.replace(pack, qpos=qpos, qvel=qvel, hand=hands(layout, qpos, qvel))
    there, batch = (_episodes(config, p, steps) for p in (moved, pack))
    found, truth = (Entities(*(f[BURN + 1 :] for f in b.states)) for b in (there, batch))
    return compared(found, truth, batch, pack)


def simulated(pack: Pack, steps: int, off: float, burn: int = BURN) -> tuple[Tensor, Tensor]:
    """qpos and qvel of all rows, those after the burn-in by C MuJoCo from a disturbed state."""
    rng = np.random.default_rng(0)
    model = assets.spec("push").compile()
    data, layout = mujoco.MjData(model), pack.layout
    column = layout.attributes.index
    sizes = [column(f"half_{axis}") for axis in "xyz"]
    qpos, qvel, ctrl = (t.double().numpy().copy() for t in (pack.qpos, pack.qvel, pack.ctrl))
    rows, world = pack.attributes.double().numpy(), pack.world.double().numpy()
    table = world[:, layout.settings.index("friction_slide")]
    for episode in range(pack.episodes):
        halves = rows[episode][:, sizes]
        density = rows[episode][:, column("mass")] / (8 * halves.prod(-1))
        drawn = list(zip(density, rows[episode][:, column("friction_slide")], strict=True))
        collect_clips.made(model, data, layout.objects, halves, drawn, table[episode])
        first = int(pack.start[episode]) + burn
        data.qpos[:], data.qvel[:] = qpos[first], qvel[first]
        for at in range(collect_clips.CUBES, model.nq, 7):
            data.qpos[at : at + 2] += 1e-3 * off * rng.normal(size=2)
            yaw, turned = np.deg2rad(off * rng.normal()), np.zeros(4)
            about = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
            mujoco.mju_mulQuat(turned, about, data.qpos[at + 3 : at + 7])
            data.qpos[at + 3 : at + 7] = turned
        qpos[first], qvel[first] = data.qpos, data.qvel
        for row in range(first, first + steps):
            data.ctrl[:] = ctrl[row]
            mujoco.mj_step(model, data, round(layout.timestep / model.opt.timestep))
            qpos[row + 1], qvel[row + 1] = data.qpos, data.qvel
    return torch.as_tensor(qpos).float(), torch.as_tensor(qvel).float()


def _episodes(config: Any, pack: Pack, steps: int) -> Batch:
    """The first `BURN` and `steps` control steps of every episode."""
    windows = Windows(pack, steps + BURN, config)
    first = torch.cat([torch.zeros_like(pack.start[:1]), windows.ends[:-1]])
    return windows.batch(*windows.locate(first))


def penetration(path: Entities, context: Context, pack: Pack) -> dict[str, Any]:
    """Deepest overlap of each episode over all steps."""
    contacts = Contacts(pack.layout).to(path.pos.device)
    deepest = path.pos.new_zeros((path.pos.shape[1], contacts.pairs))
    for t in range(len(path.pos)):
        boxes = contacts.boxes(path.at(t), context)
        gap, _ = separation(boxes.chosen(contacts.one), boxes.chosen(contacts.other))
        deepest = torch.maximum(deepest, -gap)
    between = contacts.between
    parts = {"cubes": deepest[:, :between].amax(1), "pads": deepest[:, between:].amax(1)}
    return {name: _row(depth * 1e3, 0.95) for name, depth in parts.items()}


def energies(found: Entities, truth: Entities, context: Context, pack: Pack) -> dict[str, float]:
    """Peak kinetic energy over the true peak."""
    moving = truth.vel.norm(dim=-1).amax(0) > MOVING  # [B, N]
    ours, theirs = (_kinetic(x, context, pack).amax(0)[moving] for x in (found, truth))
    ratio = (ours / theirs).double()
    low, middle, high = (float(ratio.quantile(q)) for q in (0.05, 0.5, 0.95))
    within = float(((ratio - 1.0).abs() <= WITHIN).double().mean())
    return {"p5": low, "median": middle, "p95": high, "within": within, "cubes": len(ratio)}


def _kinetic(x: Entities, context: Context, pack: Pack) -> Tensor:
    """[L, B, N], J."""
    names = pack.layout.attributes
    mass = context.attributes[..., names.index("mass")]
    inertia = context.attributes[..., [names.index(f"inertia_{axis}") for axis in "xyz"]]
    spin = rotate_back(to_matrix(x.quat), x.ang)
    return 0.5 * mass * x.vel.square().sum(-1) + 0.5 * (inertia * spin.square()).sum(-1)


def ghosts(found: Entities, truth: Entities, start: Entities) -> int:
    """Cubes that move in the model alone."""
    gone, true = ((x.pos - start.pos).norm(dim=-1).amax(0) for x in (found, truth))
    return int(((true < STILL) & (gone > GHOST)).sum())


def _completed(model: Any, path: Entities) -> Entities:
    flat = model.completed(Entities(*(field.flatten(0, 1) for field in path)))
    return Entities(*(field.unflatten(0, path.pos.shape[:2]) for field in flat))


def _angle(a: Tensor, b: Tensor) -> Tensor:
    return torch.rad2deg(logarithm(multiply(a, conjugate(b))).norm(dim=-1))


def _row(values: Tensor, level: float = 0.9) -> dict[str, float]:
    values = torch.nan_to_num(values.flatten().double(), nan=torch.inf)
    return {
        "median": float(values.median()),
        f"p{round(100 * level)}": float(values.quantile(level)),
        "worst": float(values.max()),
    }


def _read(options: Any) -> Pack:
    path = options.data
    pack = Pack.load(path) if path.suffix == ".pack" else read_data([path])
    long = torch.nonzero(pack.length >= options.steps + BURN)[: options.episodes, 0]
    return pack.subset(long)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--checkpoint", type=Path, nargs="*", default=[])
    parser.add_argument("--mujoco", type=float, nargs="*", default=[], help="mm")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path)
    return parser


if __name__ == "__main__":
    main()
