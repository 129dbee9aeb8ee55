"""The loop closed from video alone: sliding blocks, and something hidden in the true scene.

    MUJOCO_GL=egl python tools/video_loop.py see --with 40 --without 20 --out out/loop --workers 16
    python tools/video_loop.py diagnose --out out/loop --workers 16 [--patience 600]
    MUJOCO_GL=egl python tools/video_loop.py both --hidden payload --out out/payload --workers 16

What is hidden (`--hidden`): `friction`, a table whose friction is between 0.12 and 0.7 instead of
the declared 0.35; a block is set going over it. `payload`, 30 to 300 g in the middle of a block
that weighs 96 g; another block of 192 g hits it, since how a block slides by itself does not tell
its mass. `--without` episodes are as declared. Each has eight films, with two blocks six (H.264),
and what is compared knows nothing else. `see` films, reads each video as `orbisim infer` does, and
keeps the recordings (`run0.npz`, ...; `seen.json` says how far off they are, since here the truth
is known). `diagnose` takes the recordings alone: `orbisim diagnose` compares all but two of them
with the declared scene and holds two out; `diagnosis.json` has verdict, effects, value found and
true, errors before and after on what was held out. `film` makes the films alone, for another
machine to read; `both` diagnoses each episode as soon as it is seen, so that a run that is ended
has whole episodes. A process reads one film at a time, and whichever reads an episode's last one
goes on with the episode. All go on where they were ended; `--again` diagnoses anew. `summary.json`
counts all that is there.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion.estimate import read_video
from orbisim_diffusion.refine import Refiner
from orbisim_diffusion.tracking import follow, recording_of

from orbisim import make_renderer
from orbisim.cli.common import quiet_engine
from orbisim.diagnosis import Settings, diagnose
from orbisim.recording import Recording
from orbisim.report.video import write_video
from orbisim.scene import Scene, load_scene
from orbisim.state import State
from orbisim.tasks import pool

Floats = npt.NDArray[np.float64]

_WORLD = """
<mujoco model="slide">
  <option timestep="0.002" integrator="implicitfast" cone="elliptic"/>
  <visual><global offwidth="512" offheight="512"/><quality shadowsize="1024"/></visual>
  <worldbody>
    <light pos="0.2 -0.5 1.6" dir="-0.1 0.3 -1"/>
    <light pos="-0.2 0.6 1.6" dir="0.1 -0.4 -1"/>
    <camera name="side" pos="0 -0.72 0.52" xyaxes="1 0 0 0 0.585 0.811"/>
    <geom name="table" type="box" size="0.45 0.4 0.02" pos="0 0 -0.02" priority="1"
          friction="{friction} 0.005 0.0001" rgba="0.76 0.66 0.52 1"/>
    <body name="block" pos="0 0 0.02">
      <freejoint name="block"/>
      <geom name="block" type="box" size="0.04 0.03 0.02" density="500" rgba="0.8 0.2 0.2 1"/>{load}
    </body>{striker}
  </worldbody>
</mujoco>
"""
_STRIKER = """
    <body name="striker" pos="-0.2 0 0.02">
      <freejoint name="striker"/>
      <geom name="striker" type="box" size="0.04 0.03 0.02" density="1000" rgba="0.15 0.3 0.8 1"/>
    </body>"""
_LOAD = """
      <body name="load"><inertial pos="0 0 0" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/></body>"""
_FRICTION = 0.35
"""The table's, as declared."""


@dataclasses.dataclass(frozen=True)
class Hidden:
    """What the true scene has and the declared one has not.

    Attributes:
      name: key of the truth in the lines that are written. effect: its name in the catalogue.
      declared: the number as declared. bodies: that are filmed.
      films: of an episode, of which the last `_HELD` are held out. Two bodies take twice as long to
        read off a frame, so that there are fewer.
    """

    name: str
    effect: str
    declared: float
    bodies: tuple[str, ...]
    films: int

    def scene(self, value: float) -> Scene:
        """With this friction of the table, or this payload, kg."""
        if self.name == "friction":
            return load_scene(_WORLD.format(friction=value, load="", striker=""))
        load = _LOAD.format(mass=value) if value else ""
        return load_scene(_WORLD.format(friction=_FRICTION, load=load, striker=_STRIKER))

    def draw(self, rng: np.random.Generator) -> float:
        """A number that differs from the declared one: even in the logarithm."""
        if self.name == "payload":
            return float(np.exp(rng.uniform(*np.log(_LOADS))))
        value = self.declared
        while 0.75 < value / self.declared < 1.35:
            value = float(np.exp(rng.uniform(math.log(0.12), math.log(0.7))))
        return value


HIDDEN = {
    "friction": Hidden("friction", "sliding_friction", _FRICTION, ("block",), 8),
    "payload": Hidden("payload", "payload", 0.0, ("block", "striker"), 6),
}
_LOADS = (0.03, 0.3)
"""kg; the block weighs 0.096."""
_HALF = 0.02
"""Half the block's height, m. It is flat, so that it slides and does not nod: a cube's front edge
goes down by some mm when it is set going, and a body that is said to lie flat is then misplaced."""
_FPS, _FRAMES, _SIZE = 62.5, 60, 256
"""Frames a second, a whole number of time steps apart; at most so many; their height and width."""
_REST, _AFTER = 1e-3, 2
"""Slower than this, m/s, the block lies still; the film ends so many frames later."""
_REACH = (0.08, 0.36)
"""How far the block slides, m: speeds differ by a factor of two, or a force that does not depend on
speed looks like one that does."""
_GAP, _HIT, _ASIDE = (0.08, 0.14), (0.8, 1.5), 0.005
"""Between the middles of the blocks less their lengths, m: the striker slides for a tenth of a
second before it hits. Its speed then, m/s: the block slides 1 to 14 cm. How far it hits beside the
block's middle, m, standard deviation."""
_WINDOW = 0.25
"""Of the diagnosis, s: a slide takes 0.2 to 0.8 s."""
_HELD = 2
_TAKEN = "taken"
"""In the folder of an episode that is read wholly: a process goes on with it."""


def main() -> None:
    """Films and infers, or diagnoses, on several processes; prints the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("stage", choices=("film", "see", "diagnose", "both"))
    parser.add_argument("--hidden", choices=tuple(HIDDEN), default="friction")
    parser.add_argument("--with", dest="with_effect", type=int, default=40)
    parser.add_argument("--without", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--pixels", type=int, default=192, help="of the frames that are fitted")
    parser.add_argument("--effect", action="append", help="as of `orbisim diagnose`; repeatable")
    parser.add_argument(
        "--patience", type=float, default=Settings.patience, help="of each diagnosis, s"
    )
    parser.add_argument("--again", action="store_true", help="diagnose what was diagnosed before")
    parser.add_argument("--seconds", type=float, default=1e9, help="no film is begun after")
    parser.add_argument(
        "--judge-seconds", type=float, default=1e9, help="no diagnosis is begun after"
    )
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, required=True, help="folder for videos and reports")
    arguments = parser.parse_args()
    begun = time.time()
    hidden = HIDDEN[arguments.hidden]
    late = begun + arguments.judge_seconds
    asked = arguments.effect, arguments.patience, arguments.again, late
    with quiet_engine():
        for work, jobs in _stages(arguments, hidden, asked, begun + arguments.seconds):
            for _ in pool.run(work, jobs, arguments.workers):
                print(json.dumps({"seconds": round(time.time() - begun, 1)}), flush=True)
    line = summary(arguments.out, hidden)
    (arguments.out / "summary.json").write_text(json.dumps(line, indent=1) + "\n")
    print(json.dumps(line))


def _stages(
    arguments: argparse.Namespace, hidden: Hidden, asked: tuple[Any, ...], end: float
) -> Iterator[tuple[Any, list[tuple[Any, ...]]]]:
    """What is to be done one after the other, with the jobs of each."""
    out = arguments.out
    if arguments.stage == "diagnose":
        found = sorted(out.glob("*/seen.json"), key=lambda p: p.parent.name.split("_")[1])
        yield judge, [(p.parent, hidden, *asked) for p in found]
        return
    # by turns, so that a run that is ended has episodes of both kinds
    wanted = {True: arguments.with_effect, False: arguments.without}
    turns = [(i, d) for i in range(max(wanted.values())) for d in wanted if i < wanted[d]]
    episodes = [(hidden, arguments.first_seed + i, d, out) for i, d in turns]
    yield film_episode, episodes
    if arguments.stage == "film":
        return
    then = asked if arguments.stage == "both" else None
    films = range(hidden.films)
    last = "seen.json" if then is None else "diagnosis.json"
    for folder in (_folder(*one[1:]) for one in episodes):
        if not (folder / last).exists():  # another run was ended at this episode
            (folder / _TAKEN).unlink(missing_ok=True)
    yield see, [(*one, run, arguments.pixels, end, then) for one in episodes for run in films]


def film_episode(hidden: Hidden, seed: int, different: bool, out: Path) -> None:
    """Films one episode, unless that is done; keeps the true coordinates [T, 7 n] of each film."""
    folder = _folder(seed, different, out)
    kept = folder / "truth.json"
    if kept.exists():
        return
    rng = np.random.default_rng([seed, int(different)])
    value = hidden.draw(rng) if different else hidden.declared
    folder.mkdir(parents=True, exist_ok=True)
    scene = hidden.scene(value)
    start = slide if hidden.name == "friction" else strike
    made = [film(scene, start, rng, folder / f"run{run}.mp4") for run in range(hidden.films)]
    kept.write_text(
        json.dumps({hidden.name: value, "qpos": [run.round(7).tolist() for run in made]})
    )


def see(
    hidden: Hidden,
    seed: int,
    different: bool,
    out: Path,
    run: int,
    pixels: int,
    end: float,
    then: tuple[Any, ...] | None,
) -> None:
    """Infers one film, unless that is done or the time is over; with the last film of an episode
    says how far off all are, and diagnoses it.

    Args:
      then: what `judge` gets besides; None if nothing is diagnosed.
    """
    folder = _folder(seed, different, out)
    path = folder / f"run{run}.npz"
    if not path.exists():
        if time.time() > end:
            return
        torch.set_num_threads(1)
        found = inferred(hidden.scene(hidden.declared), folder / f"run{run}.mp4", pixels)
        part = path.with_suffix(".part.npz")
        found.save(part)
        part.replace(path)
    if not all((folder / f"run{k}.npz").exists() for k in range(hidden.films)):
        return
    try:  # two processes may have read the last two films at once
        (folder / _TAKEN).touch(exist_ok=False)
    except FileExistsError:
        return
    _compare(folder, hidden, seed, different)
    if then is not None:
        judge(folder, hidden, *then)


def _compare(folder: Path, hidden: Hidden, seed: int, different: bool) -> None:
    """Says how far off an episode's recordings are."""
    known = json.loads((folder / "truth.json").read_text())
    errors, seen, noise = [], [], []
    for run, qpos in enumerate(map(np.array, known["qpos"])):
        found = Recording.load(folder / f"run{run}.npz")
        for number, body in enumerate(hidden.bodies):
            apart = np.asarray(found.signals[f"xpos/{body}"]) - qpos[:, 7 * number :][:, :3]
            whole = np.isfinite(apart).all(1)
            errors.append(apart[whole])
            seen.append(float(whole.mean()))
            noise.append(np.min(found.metadata["noise"][f"xpos/{body}"]))  # along the table
    off = 1e3 * np.linalg.norm(np.concatenate(errors), axis=1)
    white = [np.diff(e, axis=0).std(0) / math.sqrt(2.0) for e in errors if len(e) > 2]
    line = {
        "seed": seed,
        "different": different,
        hidden.name: round(known[hidden.name], 4),
        "declared": hidden.declared,
        "frames": sum(len(e) for e in errors),
        "seen": round(float(np.mean(seen)), 3),
        "position_mm": {
            "median": round(float(np.median(off)), 2),
            "p90": round(float(np.quantile(off, 0.9)), 2),
            "worst": round(float(off.max()), 2),
            "from_frame_to_frame": round(1e3 * float(np.mean(white)), 2),
            "stated_noise": round(1e3 * float(np.mean(noise)), 2),
        },
    }
    (folder / "seen.json").write_text(json.dumps(line) + "\n")


def judge(
    folder: Path,
    hidden: Hidden,
    effects: list[str] | None,
    patience: float,
    again: bool,
    end: float,
) -> None:
    """Diagnoses one episode from its recordings, unless that is done or the time is over."""
    path = folder / "diagnosis.json"
    if (path.exists() and not again) or time.time() > end:
        return
    torch.set_num_threads(1)
    begun = time.time()
    recordings = [Recording.load(folder / f"run{run}.npz") for run in range(hidden.films)]
    result = diagnose(
        hidden.scene(hidden.declared),
        recordings[:-_HELD],
        recordings[-_HELD:],
        window=_WINDOW,
        settings=Settings(effects=tuple(effects) if effects else None, patience=patience),
    ).to_json()
    line = {
        **json.loads((folder / "seen.json").read_text()),
        "verdict": result["verdict"],
        "effects": result["effects"],
        "alternatives": result["alternatives"][:3],
        "error": result["error"],
        "seconds": round(time.time() - begun, 1),
    }
    path.write_text(json.dumps(line) + "\n")


def _folder(seed: int, different: bool, out: Path) -> Path:
    return out / f"{'with' if different else 'without'}_{seed:03d}"


def summary(out: Path, hidden: Hidden) -> dict[str, Any]:
    """Counts over all episodes that were diagnosed."""
    lines = [json.loads(p.read_text()) for p in sorted(out.glob("*/diagnosis.json"))]
    seen = [json.loads(p.read_text()) for p in sorted(out.glob("*/seen.json"))]
    found: dict[str, Any] = {"hidden": hidden.name, "seen": len(seen), "diagnosed": len(lines)}
    for name in ("median", "p90", "worst", "from_frame_to_frame", "stated_noise"):
        values = [line["position_mm"][name] for line in seen]
        found[f"position_mm_{name}"] = round(float(np.median(values)), 2) if values else None
    for different in (True, False):
        some = [line for line in lines if line["different"] == different]
        names = [sorted({e["effect"] for e in line["effects"]}) for line in some]
        part: dict[str, Any] = {"episodes": len(some)}
        part["verdicts"] = _counts([line["verdict"] for line in some])
        part["named"] = _counts([" + ".join(n) or "nothing" for n in names])
        if different:
            right = [i for i, n in enumerate(names) if n == [hidden.effect]]
            part[f"{hidden.effect}_alone"] = len(right)
            part[f"{hidden.effect}_among"] = sum(hidden.effect in n for n in names)
            rows = [(_first(some[i]), some[i][hidden.name]) for i in right]
            off = [abs(float(row["value"]) / true - 1.0) for row, true in rows]
            part[f"{hidden.name}_off_percent_median"] = _median(100 * np.array(off))
            inside = [row["ci95"][0] <= true <= row["ci95"][1] for row, true in rows]
            part["within_its_interval"] = sum(inside)
        if different and hidden.name == "friction":
            meant = [(line["friction"], _meant(line)) for line in some if line["effects"]]
            off = [abs(found / true - 1.0) for true, found in meant if found is not None]
            part["friction_is_meant"] = len(off)
            part["meant_off_percent_median"] = _median(100 * np.array(off))
        before = np.array([line["error"]["held_out"]["before"] for line in some], float)
        after = np.array([line["error"]["held_out"]["after"] for line in some], float)
        part["held_out_before_median"], part["held_out_after_median"] = (
            _median(before),
            _median(after),
        )
        found["with" if different else "without"] = part
    return found


def _first(line: dict[str, Any]) -> dict[str, Any]:
    """The first parameter of the first effect that was found, with value and interval."""
    found: dict[str, Any] = next(iter(line["effects"][0]["parameters"].values()))
    return found


def _meant(line: dict[str, Any]) -> float | None:
    """The friction under the block's own weight that would slow it down as what was named does.

    None if something else than friction and load was named.
    """
    model = HIDDEN["friction"].scene(_FRICTION).model
    weight = float(model.body("block").mass[0] * -model.opt.gravity[2])
    friction, load = _FRICTION, weight
    for effect in line["effects"]:
        values = {name: float(p["value"]) for name, p in effect["parameters"].items()}
        if effect["effect"] == "sliding_friction":
            friction = values["coefficient"]
        elif effect["effect"] == "constant_force":
            load -= values["z"]
        elif effect["effect"] == "buoyancy":
            load += values["displaced_mass"] * float(model.opt.gravity[2])
        else:
            return None
    return friction * load / weight


def _counts(names: list[str]) -> dict[str, int]:
    return {name: names.count(name) for name in sorted(set(names))}


def _median(values: Floats) -> float | None:
    return round(float(np.median(values)), 5) if len(values) else None


def slide(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """A block that is set going towards the middle."""
    heading, spin = rng.uniform(-np.pi, np.pi), rng.uniform(-4.0, 4.0)
    reach = float(np.exp(rng.uniform(*np.log(_REACH))))
    direction = np.array([np.cos(heading), np.sin(heading)])
    yaw = rng.uniform(-np.pi, np.pi)
    friction = float(model.geom("table").friction[0])
    data.qpos[:2] = -0.5 * reach * direction * [1.0, 0.7]
    data.qpos[2:] = [_HALF, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
    data.qvel[:2] = np.sqrt(2 * friction * 9.81 * reach) * direction
    data.qvel[5] = spin


def strike(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """A block at rest near the middle, and the striker on its way to it, end on."""
    heading = rng.uniform(-np.pi, np.pi)
    direction = np.array([np.cos(heading), np.sin(heading)])
    gap, speed = rng.uniform(*_GAP), rng.uniform(*_HIT)
    length = float(2.0 * model.geom("block").size[0])
    spot = rng.uniform(-0.06, 0.06, 2) - 0.03 * direction
    aside = rng.normal(0.0, _ASIDE) * np.array([-direction[1], direction[0]])
    for at, place in ((0, spot), (7, spot + aside - (length + gap) * direction)):
        yaw = heading + rng.normal(0.0, 0.1)
        data.qpos[at : at + 2] = place
        data.qpos[at + 2 : at + 7] = [_HALF, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
    data.qvel[6:8] = np.sqrt(speed**2 + 2 * _FRICTION * 9.81 * gap) * direction


def film(scene: Scene, start: Any, rng: np.random.Generator, path: Path) -> Floats:
    """What `start` sets going, until it rests; its true coordinates [T, 7 n] at the frames."""
    model, data = scene.model, mujoco.MjData(scene.model)
    start(model, data, rng)
    renderer = make_renderer("mujoco", scene)
    every = round(1.0 / _FPS / model.opt.timestep)
    frames, found, still = [], [], 0
    for _ in range(_FRAMES):
        state = State(np.zeros(1), data.qpos[None].copy(), data.qvel[None].copy(), np.zeros((1, 0)))
        image = renderer.render(state, camera="side", height=_SIZE, width=_SIZE)
        frames.append(np.asarray(image).reshape(_SIZE, _SIZE, 3))
        found.append(data.qpos.copy())
        mujoco.mj_step(model, data, every)
        still = still + 1 if float(np.linalg.norm(data.qvel)) < _REST else 0
        if still > _AFTER:
            break
    renderer.close()
    write_video(path, frames, _FPS)
    return np.array(found)


def inferred(scene: Scene, video: Path, pixels: int) -> Recording:
    """As `orbisim infer` does without a network."""
    frames, times = read_video(video, pixels)
    refiner = Refiner(scene, scene.model.camera("side").id, pixels)
    return recording_of(scene, refiner, times, follow(refiner, frames, None))


if __name__ == "__main__":
    main()
