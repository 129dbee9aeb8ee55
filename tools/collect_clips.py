"""Short clips of `push` or `shove` around contacts: most of what must be learned happens there.

    python tools/collect_clips.py push_train.h5 push_hold_train.h5 --out push_clips_train.pack
        [--clips 60000] [--seconds 120] [--length 16] [--workers 16] [--seed 0]
        [--throws 0.5] [--scene task:push] [--hard CHECKPOINT] [--device cuda]

Each clip begins at a state of an episode shortly before a cube's velocity changes (a share of them
anywhere), turned about the robot's vertical axis, with cubes and arm moved by up to centimetres
and degrees, and other densities and frictions, and is simulated by C MuJoCo under the episode's
own controls, as much moved. Starts with an overlap deeper than a millimetre are drawn again.

With `--throws`, that share of the clips has cubes of its own, thrown at each other as those of
`task:shove` are, whatever the cubes of the episode do; the arm is the episode's.

With `--hard`, half of the clips begin where this checkpoint errs: at a state with a chance in
proportion to how far off a cube is after a clip's length, open loop along the episode itself. Its
episodes should be others than those that the checkpoint was trained on, on which it errs less.
"""

from __future__ import annotations

import argparse
import functools
import json
import multiprocessing
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from orbisim_world_model.pack import Pack, hands, no_parts  # noqa: E402  (needs the path above)
from orbisim_world_model.packing import read_data  # noqa: E402
from orbisim_world_model.reading import read_attributes, read_settings  # noqa: E402

from orbisim import load_scene  # noqa: E402
from orbisim.errors import InputError  # noqa: E402
from orbisim.tasks.shove import ShoveConfig, throw  # noqa: E402
from orbisim.tasks.tabletop import draw_setting  # noqa: E402

ARM, CUBES = 6, 8
"""Joints of the arm; first coordinate of the cubes."""
EVENT, AHEAD, ANYWHERE = 0.02, 3, 0.15
"""m/s that a cube's velocity changes in a step; steps ahead; share of starts anywhere."""
TURN = 0.35
"""rad, about the vertical."""
OFF = {"place": 0.008, "yaw": 0.3, "speed": 0.1, "spin": 1.0, "arm": 0.01}
"""m, rad, m/s, rad/s, rad: scales of what is moved."""
DENSITY, FRICTION, TABLE, WIDE, OFTEN = (150, 900), (0.2, 0.6), (0.2, 0.6), (0.05, 1.0), 0.3
"""Ranges; `WIDE` is the table's in a share `OFTEN` of the clips."""
DEEP, FAST, TRIES = 1e-3, 8.0, 20
"""m, m/s or rad/s of a cube, draws of a start."""
BATCH, LEVELS = 8192, (0.5, 0.9, 1.0)
"""Rollouts of a checkpoint at once, and the quantiles of its errors that are printed."""


def main() -> None:
    """Reads, simulates, writes."""
    options = _parser().parse_args()
    began = time.monotonic()
    pack = read_data(options.data)
    rows, episodes = starts(pack, options.length)
    generate = functools.partial(
        _clip, length=options.length, seed=options.seed, throws=options.throws
    )
    chances = np.full(len(rows), 1.0 / len(rows))
    if options.hard is not None:
        off = misses(pack, rows, episodes, options)
        print(json.dumps({"misses_mm": [float(v) for v in 1e3 * np.quantile(off, LEVELS)]}))
        chances = 0.5 * chances + 0.5 * off / off.sum()
    model = load_scene(options.scene).model if options.scene else scene(pack)
    _Worker.give(pack, rows, episodes, np.cumsum(chances), model)
    found, tried = [], 0
    context = multiprocessing.get_context("fork")
    with context.Pool(options.workers) as pool:
        for clip in pool.imap_unordered(generate, range(options.clips), chunksize=16):
            tried += 1
            if clip is not None:
                found.append(clip)
            if time.monotonic() - began > options.seconds:
                pool.terminate()
                break
    torch.set_num_threads(options.workers)  # the workers are gone; of each state the hand's follows
    packed(pack, found, options).save(options.out)
    said = {"clips": len(found), "tried": tried, "starts": len(rows)}
    print(json.dumps({**said, "seconds": round(time.monotonic() - began, 1)}), flush=True)


def starts(pack: Pack, length: int) -> tuple[Any, Any]:
    """Rows where clips may start and their episodes; rows before events first drawn from."""
    counts = (pack.length - length).clamp_min(0)
    episode = torch.repeat_interleave(torch.arange(pack.episodes), counts)
    before = torch.cumsum(counts, 0) - counts
    row = torch.arange(int(counts.sum())) - before[episode] + pack.start[episode]
    speed = pack.qvel[:, CUBES:].reshape(len(pack.qvel), -1, 6)[..., :3]
    change = (speed[1:] - speed[:-1]).norm(dim=-1).amax(1)
    soon = torch.stack([change[row + k] for k in range(AHEAD)]).amax(0) > EVENT
    anywhere = torch.rand(len(row), generator=torch.Generator().manual_seed(0))
    share = ANYWHERE * float(soon.float().mean())
    chosen = soon | (anywhere < share)
    return row[chosen].numpy(), episode[chosen].numpy()


@torch.no_grad()
def misses(pack: Pack, rows: Any, episodes: Any, options: Any) -> Any:
    """By how much, m, the worst cube is elsewhere after a clip from each of these rows."""
    from orbisim_world_model.checkpoint import load_for
    from orbisim_world_model.sampling import Windows
    from orbisim_world_model.unroll import open_loop

    pack = pack.to(options.device)
    model = load_for(options.hard, pack.layout).model.to(options.device).eval()
    windows = Windows(pack, options.length, model.config)
    found = []
    for part in zip(*(torch.as_tensor(a).split(BATCH) for a in (rows, episodes)), strict=True):
        batch = windows.batch(*(a.to(options.device) for a in part))
        end = open_loop(model, batch, 0).pos[-1]
        off = (end - batch.states.pos[-1]).norm(dim=-1).amax(1)
        found.append(off.nan_to_num(1.0).clamp(max=1.0).cpu())
    return torch.cat(found).double().numpy()


def scene(pack: Pack) -> Any:
    """The model of the episodes' task.

    Raises:
      InputError: their grippers are not equally strong, so that no one model is theirs all.
    """
    names = {source["task"] for source in pack.notes["sources"]}
    models = [load_scene(name).model for name in sorted(names)]
    if any(
        not np.array_equal(models[0].actuator_forcerange, m.actuator_forcerange) for m in models
    ):
        raise InputError(f"episodes of {', '.join(sorted(names))} are of robots of unequal force")
    return models[0]


class _Worker:
    """What a process has: set before it is forked."""

    pack: Any
    rows: Any
    episodes: Any
    upto: Any
    model: Any
    data: Any

    @classmethod
    def give(cls, pack: Pack, rows: Any, episodes: Any, upto: Any, model: Any) -> None:
        """Takes over the episodes and the scene; `upto`: chances of the rows, added up."""
        cls.pack = {n: getattr(pack, n).double().numpy() for n in ("qpos", "qvel", "ctrl")}
        cls.pack |= {"attributes": pack.attributes.double().numpy(), "layout": pack.layout}
        cls.rows, cls.episodes, cls.upto = rows, episodes, upto
        cls.model = model
        cls.data = mujoco.MjData(cls.model)


def _clip(number: int, length: int, seed: int, throws: float) -> dict[str, Any] | None:
    """One clip, or None if no start was found or the simulation went wrong."""
    rng = np.random.default_rng([seed, number])
    w, model, data = _Worker, _Worker.model, _Worker.data
    index = min(int(np.searchsorted(w.upto, rng.random(), side="right")), len(w.rows) - 1)
    row, episode = int(w.rows[index]), int(w.episodes[index])
    thrown = throws > 0 and rng.random() < throws  # without any, clips are those of old seeds
    if not thrown:
        describe(model, data, w.pack["attributes"][episode], w.pack["layout"], rng)
    for _ in range(TRIES):
        if thrown:
            ctrl = thrown_at(model, data, w.pack, row, length, rng)
        else:
            ctrl = place(data, w.pack, row, length, rng)
        mujoco.mj_forward(model, data)
        if not data.ncon or data.contact.dist[: data.ncon].min() > -DEEP:
            break
    else:
        return None
    qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
    substeps = round(w.pack["layout"].timestep / model.opt.timestep)
    for t in range(length):
        data.ctrl[:] = ctrl[t]
        mujoco.mj_step(model, data, substeps)
        qpos.append(data.qpos.copy())
        qvel.append(data.qvel.copy())
    speeds = np.array(qvel)
    if data.warning.number.any() or not np.abs(speeds[:, CUBES:]).max() < 20 * FAST:
        return None
    return {
        "qpos": np.array(qpos, np.float32),
        "qvel": speeds.astype(np.float32),
        "ctrl": np.concatenate([ctrl, ctrl[:1] * 0]).astype(np.float32),
        "attributes": read_attributes(model, w.pack["layout"]).astype(np.float32),
        "world": read_settings(model, w.pack["layout"]).astype(np.float32),
    }


def describe(model: Any, data: Any, rows: Any, layout: Any, rng: Any) -> None:
    """Gives the model the cubes' sizes of an episode, and densities and frictions of its own."""
    sizes = [layout.attributes.index(f"half_{axis}") for axis in "xyz"]
    drawn = [(rng.uniform(*DENSITY), rng.uniform(*FRICTION)) for _ in layout.objects]
    table = rng.uniform(*(WIDE if rng.random() < OFTEN else TABLE))
    made(model, data, layout.objects, rows[:, sizes], drawn, table)


def made(model: Any, data: Any, names: Any, halves: Any, drawn: Any, table: float) -> None:
    """Gives the model cubes of these half sides [N, 3] and (density, friction), and the table's."""
    for name, half, (density, friction) in zip(names, halves, drawn, strict=True):
        body, geom = model.body(name).id, model.geom(name).id
        mass = float(density) * 8 * float(np.prod(half))
        model.geom_size[geom] = half
        model.geom_rbound[geom] = np.linalg.norm(half)
        model.geom_aabb[geom] = [0, 0, 0, *half]
        model.body_mass[body] = mass
        model.body_inertia[body] = mass / 3 * (np.sum(half**2) - half**2)
        model.geom_friction[geom, 0] = friction
    model.geom_friction[model.geom("table").id, 0] = table
    mujoco.mj_resetData(model, data)
    mujoco.mj_setConst(model, data)


def thrown_at(model: Any, data: Any, pack: Any, row: int, length: int, rng: Any) -> Any:
    """Cubes of their own, one thrown at the other; the arm of a row, and its controls [length, nu].

    Raises:
      InputError: the episodes have another number of cubes than two.
    """
    names = pack["layout"].objects
    if len(names) != 2:
        raise InputError(f"--throws: episodes with {len(names)} cubes; a throw takes two")
    config = ShoveConfig()
    setting = draw_setting(config, len(names), rng)
    halves = [np.full(3, cube.half) for cube in setting.cubes]
    drawn = [(cube.density, cube.friction) for cube in setting.cubes]
    made(model, data, names, halves, drawn, setting.table_friction)
    poses, velocity = throw(setting, config, rng)
    data.qpos[:CUBES], data.qvel[:CUBES] = (pack[n][row, :CUBES] for n in ("qpos", "qvel"))
    data.qpos[CUBES:] = np.concatenate([pose.qpos for pose in poses])
    data.qvel[CUBES:] = np.concatenate([velocity, np.zeros(6)])
    return pack["ctrl"][row : row + length].copy()


def place(data: Any, pack: Any, row: int, length: int, rng: Any) -> Any:
    """Sets the state of a row, turned and moved; returns its controls [length, nu]."""
    size, turn = 10 ** rng.uniform(-1.5, 0), rng.uniform(-TURN, TURN)
    data.qpos[:], data.qvel[:] = pack["qpos"][row], pack["qvel"][row]
    ctrl = pack["ctrl"][row : row + length].copy()
    off = size * rng.normal(0, OFF["arm"], ARM)
    off[0] += turn
    data.qpos[:ARM] += off
    ctrl[:, :ARM] += off
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    for first in range(CUBES, len(data.qpos), 7):
        v = 8 + 6 * ((first - CUBES) // 7)
        spot = data.qpos[first : first + 2] + size * rng.normal(0, OFF["place"], 2)
        data.qpos[first : first + 2] = rotation @ spot
        yaw = turn + size * rng.normal(0, OFF["yaw"])
        quat = np.zeros(4)
        about = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
        mujoco.mju_mulQuat(quat, about, data.qpos[first + 3 : first + 7])
        data.qpos[first + 3 : first + 7] = quat
        moving = np.linalg.norm(data.qvel[v : v + 3]) > 1e-3 or rng.random() < 0.3
        data.qvel[v : v + 2] = rotation @ data.qvel[v : v + 2]
        if moving:
            data.qvel[v : v + 2] += size * rng.normal(0, OFF["speed"], 2)
            data.qvel[v + 5] += size * rng.normal(0, OFF["spin"])
    return ctrl


def packed(pack: Pack, clips: list[dict[str, Any]], options: Any) -> Pack:
    """The clips as episodes of a pack."""
    rows = options.length + 1
    joined = {n: torch.as_tensor(np.stack([c[n] for c in clips])) for n in clips[0]}
    qpos, qvel, ctrl = (joined[n].flatten(0, 1) for n in ("qpos", "qvel", "ctrl"))
    count = len(clips)
    notes = {
        **pack.notes,
        "groups": ["clips"],
        "sources": [{"file": options.out.name, "task": pack.notes["sources"][0]["task"],
                     "seed": options.seed, "episodes": count}],
    }  # fmt: skip
    return Pack(
        layout=pack.layout,
        qpos=qpos,
        qvel=qvel,
        act=torch.zeros(len(qpos), 0),
        ctrl=ctrl,
        action=ctrl,
        hand=hands(pack.layout, qpos, qvel),
        base=torch.zeros(len(qpos), 0),
        start=torch.arange(count) * rows,
        length=torch.full((count,), options.length),
        attributes=joined["attributes"],
        world=joined["world"],
        mask=torch.ones(count, len(pack.layout.objects)),
        group=torch.zeros(count, dtype=torch.long),
        **no_parts(count),
        notes=notes,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--clips", type=int, default=60_000)
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--length", type=int, default=16)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scene", help="whose robot the clips have; the episodes' task's if none")
    parser.add_argument("--throws", type=float, default=0.0, help="share of clips")
    parser.add_argument("--hard", type=Path, help="checkpoint whose errors say where to begin")
    parser.add_argument("--device", default="cpu", help="of `--hard`")
    return parser


if __name__ == "__main__":
    main()
