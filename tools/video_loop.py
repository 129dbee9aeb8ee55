"""The loop closed from video alone: a sliding cube, a table whose friction is another one.

    python tools/video_loop.py --with 5 --without 3 --out out/video_loop [--first-seed 0]

Each episode is a true scene, whose table has a friction between 0.12 and 0.7 (`--without`: the
declared 0.35). A cube is set going over it four times, a camera films it (an H.264 file each), and
nothing else is kept. `orbisim infer` reads each video, `orbisim diagnose` compares three of them
with the declared scene and holds one out. A line of JSON for each episode: verdict, effects,
friction found and true, errors before and after on what was held out, and, since here the truth is
known, how far off the inferred positions are.
"""

from __future__ import annotations

import argparse
import json
import math
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
from orbisim.diagnosis import Settings, diagnose
from orbisim.recording import Recording
from orbisim.report.video import write_video
from orbisim.scene import Scene, load_scene
from orbisim.state import State

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
    <body name="cube" pos="0 0 0.03">
      <freejoint name="cube"/>
      <geom name="cube" type="box" size="0.03 0.03 0.03" density="500" rgba="0.8 0.2 0.2 1"/>
    </body>
  </worldbody>
</mujoco>
"""
_FPS, _FRAMES, _SIZE = 62.5, 60, 256
"""Frames a second, a whole number of time steps apart; at most so many; their height and width."""
_REST, _AFTER = 1e-3, 2
"""Slower than this, m/s, the cube lies still; the film ends so many frames later."""
_WINDOW = 0.15
"""Of the diagnosis, s: a slide takes 0.2 to 0.7 s."""
_RUNS, _HELD = 4, 1


def main() -> None:
    """Prints a line of JSON for each episode."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--with", dest="with_effect", type=int, default=5)
    parser.add_argument("--without", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--pixels", type=int, default=128, help="of the frames that are fitted")
    parser.add_argument("--effect", action="append", help="as of `orbisim diagnose`; repeatable")
    parser.add_argument("--patience", type=float, default=600.0, help="of each diagnosis, s")
    parser.add_argument("--out", type=Path, required=True, help="folder for videos and reports")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    settings = Settings(
        effects=tuple(arguments.effect) if arguments.effect else None, patience=arguments.patience
    )
    # by turns, so that a run that is ended has both
    wanted = {True: arguments.with_effect, False: arguments.without}
    turns = range(max(wanted.values()))
    for number, different in [(i, d) for i in turns for d, n in wanted.items() if i < n]:
        folder = arguments.out / f"{'with' if different else 'without'}_{number}"
        seed = arguments.first_seed + number
        line = episode(seed, different, folder, arguments.pixels, settings)
        print(json.dumps(line), flush=True)
        with (arguments.out / "episodes.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")


def episode(
    seed: int, different: bool, folder: Path, pixels: int, settings: Settings
) -> dict[str, Any]:
    """Films, infers and diagnoses one."""
    rng = np.random.default_rng([seed, int(different)])
    friction = DECLARED
    while different and 0.75 < friction / DECLARED < 1.35:
        friction = float(np.exp(rng.uniform(math.log(0.12), math.log(0.7))))
    folder.mkdir(parents=True, exist_ok=True)
    declared = load_scene(SCENE.format(friction=DECLARED))
    truth = load_scene(SCENE.format(friction=friction))
    recordings, errors, seen = [], [], []
    for run in range(_RUNS):
        qpos = film(truth, friction, rng, folder / f"run{run}.mp4")
        found = inferred(declared, folder / f"run{run}.mp4", pixels)
        found.save(folder / f"run{run}.npz")
        apart = np.linalg.norm(np.asarray(found.signals["xpos/cube"]) - qpos[:, :3], axis=1)
        errors.append(apart[np.isfinite(apart)])
        seen.append(float(np.isfinite(apart).mean()))
        recordings.append(found)
    result = diagnose(
        declared,
        recordings[:-_HELD],
        recordings[-_HELD:],
        window=_WINDOW,
        settings=settings,
        out=folder / "diagnosis",
    ).to_json()
    off = 1e3 * np.concatenate(errors)
    return {
        "seed": seed,
        "different": different,
        "friction": round(friction, 4),
        "declared": DECLARED,
        "seen": round(float(np.mean(seen)), 3),
        "position_mm": {
            "median": round(float(np.median(off)), 2),
            "p90": round(float(np.quantile(off, 0.9)), 2),
            "worst": round(float(off.max()), 2),
        },
        "verdict": result["verdict"],
        "effects": result["effects"],
        "alternatives": result["alternatives"][:3],
        "error": result["error"],
    }


def film(scene: Scene, friction: float, rng: np.random.Generator, path: Path) -> Floats:
    """A cube that is set going towards the middle; its true coordinates [T, 7] at the frames."""
    model, data = scene.model, mujoco.MjData(scene.model)
    heading, spin = rng.uniform(-np.pi, np.pi), rng.uniform(-4.0, 4.0)
    reach = rng.uniform(0.15, 0.3)
    direction = np.array([np.cos(heading), np.sin(heading)])
    yaw = rng.uniform(-np.pi, np.pi)
    data.qpos[:2] = -0.5 * reach * direction * [1.0, 0.7]
    data.qpos[2:] = [0.0299, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
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
