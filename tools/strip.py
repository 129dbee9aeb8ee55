"""A strip of pictures of one episode: one backend a row, moments from left to right.

    python tools/strip.py task:mechanism:door-held_out --backends mujoco learned \\
        --times 2 4.5 7 9 12 15 --about door_leaf --view 150 -25 0.9 --out docs/images/door.jpg

All rows begin in the same state and take the same controls.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from orbisim import make_backend  # noqa: E402  (needs the path above)
from orbisim.episodes import episodes  # noqa: E402

QUALITY = 80


def main() -> None:
    """Simulates, draws and writes."""
    options = _parser().parse_args()
    found = episodes(options.task, 1, options.seed)
    rows = []
    for name in options.backends:
        backend = make_backend(name, found.scene)
        controls = found.controls(max(options.times), options.step, options.seed)
        nstep = round(options.step / backend.timestep)
        path = backend.rollout(found.initial, controls, nstep=nstep)
        at = [round(t / options.step) - 1 for t in options.times]
        rows.append(pictures(found.scene.model, np.asarray(path.qpos)[0, at], options))
    strip = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    options.out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(strip).save(options.out, quality=QUALITY, optimize=True)
    print(f"{options.out}: {options.out.stat().st_size} bytes")


def pictures(model: mujoco.MjModel, qpos: np.ndarray, options: argparse.Namespace) -> list:  # type: ignore[type-arg]
    """[size, size, 3] of each state."""
    data, drawn, camera = mujoco.MjData(model), [], mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    camera.lookat[:] = data.body(options.about).xpos
    camera.azimuth, camera.elevation, camera.distance = options.view
    with mujoco.Renderer(model, options.size, options.size) as renderer:
        for row in qpos:
            data.qpos[:] = row
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            drawn.append(renderer.render())
    return drawn


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task")
    parser.add_argument("--backends", nargs="+", default=["mujoco", "learned"])
    parser.add_argument(
        "--step", type=float, default=0.05, help="of control, s; of the tasks with an arm 0.05"
    )
    parser.add_argument("--times", type=float, nargs="+", default=[2, 4.5, 7, 9, 12, 15])
    parser.add_argument("--about", required=True, help="the body that is looked at")
    parser.add_argument(
        "--view", type=float, nargs=3, default=[150, -25, 0.9], help="azimuth, elevation, distance"
    )
    parser.add_argument("--size", type=int, default=160)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    return parser


if __name__ == "__main__":
    main()
