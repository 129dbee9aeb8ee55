"""The loop closed from video alone: a sliding block, a table whose friction is another one.

    MUJOCO_GL=egl python tools/video_loop.py see --with 40 --without 20 --out out/loop --workers 16
    python tools/video_loop.py diagnose --out out/loop --workers 16 [--patience 600]

Each episode is a true scene, whose table has a friction between 0.12 and 0.7 (`--without`: the
declared 0.35). A block is set going over it eight times, a camera films it (an H.264 file each),
and what is compared knows nothing else. `see` films, reads each video as `orbisim infer` does, and
keeps the recordings (`run0.npz`, ...; `seen.json` says how far off they are, since here the truth
is known). `diagnose` takes the recordings alone: `orbisim diagnose` compares six of them with the
declared scene and holds two out; `diagnosis.json` has verdict, effects, friction found and true,
errors before and after on what was held out. `film` makes the films alone, for another machine to
read; `both` diagnoses each episode as soon as it is seen, so that a run that is ended has whole
episodes. All go on where they were ended; `--again` diagnoses anew. `summary.json` counts all that
is there.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
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

DECLARED = 0.35
"""The table's friction as the scene declares it."""
SCENE = """
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
      <geom name="block" type="box" size="0.04 0.03 0.02" density="500" rgba="0.8 0.2 0.2 1"/>
    </body>
  </worldbody>
</mujoco>
"""
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
_WINDOW = 0.25
"""Of the diagnosis, s: a slide takes 0.2 to 0.8 s."""
_RUNS, _HELD = 8, 2


def main() -> None:
    """Films and infers, or diagnoses, on several processes; prints the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("stage", choices=("film", "see", "diagnose", "both"))
    parser.add_argument("--with", dest="with_effect", type=int, default=40)
    parser.add_argument("--without", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--pixels", type=int, default=192, help="of the frames that are fitted")
    parser.add_argument("--effect", action="append", help="as of `orbisim diagnose`; repeatable")
    parser.add_argument(
        "--patience", type=float, default=Settings.patience, help="of each diagnosis, s"
    )
    parser.add_argument("--again", action="store_true", help="diagnose what was diagnosed before")
    parser.add_argument("--seconds", type=float, default=1e9, help="no episode is begun after")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, required=True, help="folder for videos and reports")
    arguments = parser.parse_args()
    begun = time.time()
    end = begun + arguments.seconds
    asked = arguments.effect, arguments.patience, arguments.again, end
    work: Any = judge
    if arguments.stage == "diagnose":
        found = sorted(arguments.out.glob("*/seen.json"), key=lambda p: p.parent.name.split("_")[1])
        jobs: list[tuple[Any, ...]] = [(p.parent, *asked) for p in found]
    else:
        # by turns, so that a run that is ended has episodes of both kinds
        wanted = {True: arguments.with_effect, False: arguments.without}
        turns = [(i, d) for i in range(max(wanted.values())) for d in wanted if i < wanted[d]]
        jobs = [(arguments.first_seed + i, d, arguments.out) for i, d in turns]
        if arguments.stage == "film":
            work = film_episode
        else:
            jobs, work = [(*job, arguments.pixels, end) for job in jobs], see
        if arguments.stage == "both":
            jobs, work = [(asked, *job) for job in jobs], see_and_judge
    with quiet_engine():
        for _ in pool.run(work, jobs, arguments.workers):
            print(json.dumps({"seconds": round(time.time() - begun, 1)}), flush=True)
    line = summary(arguments.out)
    (arguments.out / "summary.json").write_text(json.dumps(line, indent=1) + "\n")
    print(json.dumps(line))


def film_episode(seed: int, different: bool, out: Path) -> tuple[float, list[Floats]]:
    """Films one episode, unless that is done: its friction, and true coordinates [T, 7] by film."""
    folder = _folder(seed, different, out)
    kept = folder / "truth.json"
    if kept.exists():
        known = json.loads(kept.read_text())
        return known["friction"], [np.array(run) for run in known["qpos"]]
    rng = np.random.default_rng([seed, int(different)])
    friction = DECLARED
    while different and 0.75 < friction / DECLARED < 1.35:
        friction = float(np.exp(rng.uniform(math.log(0.12), math.log(0.7))))
    folder.mkdir(parents=True, exist_ok=True)
    scene = load_scene(SCENE.format(friction=friction))
    made = [film(scene, friction, rng, folder / f"run{run}.mp4") for run in range(_RUNS)]
    kept.write_text(
        json.dumps({"friction": friction, "qpos": [run.round(7).tolist() for run in made]})
    )
    return friction, made


def see(seed: int, different: bool, out: Path, pixels: int, end: float) -> None:
    """Films and infers one episode, unless that is done or the time is over."""
    folder = _folder(seed, different, out)
    if (folder / "seen.json").exists() or time.time() > end:
        return
    torch.set_num_threads(1)
    friction, truth = film_episode(seed, different, out)
    declared = load_scene(SCENE.format(friction=DECLARED))
    errors, seen, noise = [], [], []
    for run, qpos in enumerate(truth):
        found = inferred(declared, folder / f"run{run}.mp4", pixels)
        found.save(folder / f"run{run}.npz")
        apart = np.asarray(found.signals["xpos/block"]) - qpos[:, :3]
        whole = np.isfinite(apart).all(1)
        errors.append(apart[whole])
        seen.append(float(whole.mean()))
        noise.append(np.min(found.metadata["noise"]["xpos/block"]))  # along the table
    off = 1e3 * np.linalg.norm(np.concatenate(errors), axis=1)
    white = [np.diff(e, axis=0).std(0) / math.sqrt(2.0) for e in errors if len(e) > 2]
    line = {
        "seed": seed,
        "different": different,
        "friction": round(friction, 4),
        "declared": DECLARED,
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


def see_and_judge(asked: tuple[Any, ...], seed: int, different: bool, out: Path, *how: Any) -> None:
    """Both for one episode; `asked` and `how` are what `judge` and `see` get besides."""
    see(seed, different, out, *how)
    if (_folder(seed, different, out) / "seen.json").exists():
        judge(_folder(seed, different, out), *asked)


def judge(
    folder: Path, effects: list[str] | None, patience: float, again: bool, end: float
) -> None:
    """Diagnoses one episode from its recordings, unless that is done or the time is over."""
    path = folder / "diagnosis.json"
    if (path.exists() and not again) or time.time() > end:
        return
    torch.set_num_threads(1)
    begun = time.time()
    recordings = [Recording.load(folder / f"run{run}.npz") for run in range(_RUNS)]
    result = diagnose(
        load_scene(SCENE.format(friction=DECLARED)),
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


def summary(out: Path) -> dict[str, Any]:
    """Counts over all episodes that were diagnosed."""
    lines = [json.loads(p.read_text()) for p in sorted(out.glob("*/diagnosis.json"))]
    seen = [json.loads(p.read_text()) for p in sorted(out.glob("*/seen.json"))]
    found: dict[str, Any] = {"seen": len(seen), "diagnosed": len(lines)}
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
            right = [i for i, n in enumerate(names) if n == ["sliding_friction"]]
            part["sliding_friction_alone"] = len(right)
            part["sliding_friction_among"] = sum("sliding_friction" in n for n in names)
            off = [abs(_value(some[i]) / some[i]["friction"] - 1.0) for i in right]
            part["friction_off_percent_median"] = _median(100 * np.array(off))
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


def _value(line: dict[str, Any]) -> float:
    """The friction that was found: the first parameter's value."""
    parameters = line["effects"][0]["parameters"]
    return float(next(iter(parameters.values()))["value"])


def _meant(line: dict[str, Any]) -> float | None:
    """The friction under the block's own weight that would slow it down as what was named does.

    None if something else than friction and load was named.
    """
    model = load_scene(SCENE.format(friction=DECLARED)).model
    weight = float(model.body("block").mass[0] * -model.opt.gravity[2])
    friction, load = DECLARED, weight
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


def film(scene: Scene, friction: float, rng: np.random.Generator, path: Path) -> Floats:
    """A block that is set going towards the middle; its true coordinates [T, 7] at the frames."""
    model, data = scene.model, mujoco.MjData(scene.model)
    heading, spin = rng.uniform(-np.pi, np.pi), rng.uniform(-4.0, 4.0)
    reach = float(np.exp(rng.uniform(*np.log(_REACH))))
    direction = np.array([np.cos(heading), np.sin(heading)])
    yaw = rng.uniform(-np.pi, np.pi)
    data.qpos[:2] = -0.5 * reach * direction * [1.0, 0.7]
    data.qpos[2:] = [_HALF, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
    data.qvel[:2] = np.sqrt(2 * friction * 9.81 * reach) * direction
    data.qvel[5] = spin
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
