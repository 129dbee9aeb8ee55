"""`make demo`: two backends on two scenes, an arm whose scene lacks something, and a pushed cube as
MuJoCo and as the diffusion renderer show it."""

from __future__ import annotations

import html
import sys
import time
from pathlib import Path

import imageio.v3 as iio
import numpy as np

from orbisim import make_renderer
from orbisim.cli.main import run
from orbisim.errors import MissingDependencyError
from orbisim.files.reading import read_json
from orbisim.files.writing import write_text
from orbisim.report.video import difference
from orbisim.state import State
from orbisim.tasks.registry import make

OUT = Path("out/demo")
ARM = Path("mjcf_assets/arm2")
SCENES = ("suite:cheetah-run", "suite:manipulator-bring_ball")


def main() -> int:
    started = time.monotonic()
    print("The first run compiles MuJoCo-Warp's kernels, about half a minute for each scene.\n")
    for scene in SCENES:
        folder = OUT / scene.partition(":")[2]
        status = run(
            ["compare", scene, "--a", "mujoco", "--b", "warp", "--episodes", "8"]
            + ["--horizon", "0.5", "--out", str(folder)]
        )
        print()
        if status:
            return status
    print("Four recordings of an arm, with an effect that its scene does not declare:")
    runs = [str(path) for path in sorted((ARM / "example").glob("*.npz"))]
    status = run(["diagnose", str(ARM / "scene.xml"), *runs, "--out", str(OUT / "diagnosis")])
    print()
    if status:
        return status
    try:
        strip(OUT / "vision.png")
        shown = ""
    except MissingDependencyError as error:  # PyTorch is large; the rest goes without
        shown = f"No images by the diffusion renderer: {error}"
        print(shown)
    page(OUT / "index.html", shown)
    print(f"Done in {time.monotonic() - started:.0f} s. Open in a browser:")
    print(f"  {(OUT / 'index.html').resolve()}")
    return 0


def page(path: Path, no_vision: str) -> None:
    """A page that links what was made.

    Args:
      no_vision: why there is no `vision.png` beside it; empty if there is.
    """
    found = read_json(OUT / "diagnosis" / "report.json")["sentence"]
    items = [
        (f"{scene.partition(':')[2]}/report.html", f"Two engines on {scene}, side by side", "")
        for scene in SCENES
    ]
    items.append(("diagnosis/report.html", "What the arm's scene lacks", found))
    items.append(("diagnosis/augmented/patch.diff", "The same as a patch of its file", ""))
    body = "".join(
        f'<li><a href="{link}">{html.escape(title)}</a><br>{html.escape(text)}</li>'
        for link, title, text in items
    )
    picture = (
        f"<p>{html.escape(no_vision)}</p>"
        if no_vision
        else "<p>A pushed cube at five times: MuJoCo, the diffusion renderer, the difference.</p>"
        '<img src="vision.png" alt="MuJoCo, diffusion, difference">'
    )
    write_text(
        path,
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>OrbiSim: the demo</title>'
        '<meta name="viewport" content="width=device-width">'
        "<style>body{font:16px/1.5 sans-serif;max-width:46rem;margin:2rem auto;padding:0 1rem}"
        "img{max-width:100%}li{margin:.6rem 0}</style>"
        f"<h1>What the demo made</h1><ul>{body}</ul>{picture}</html>\n",
    )


def strip(path: Path) -> None:
    """An episode of pushing at five times: MuJoCo above, the diffusion renderer, the difference."""
    task = make("push")
    episode = task.episode("to_hit", 7)
    scene, rows = task.scene("to_hit", 7), []
    states = []
    for t in range(0, episode.steps, episode.steps // 5):
        time_, qpos, qvel, act = (episode.arrays[n][t] for n in ("time", "qpos", "qvel", "act"))
        states.append(State(time_[None], qpos[None], qvel[None], act[None]))
    for name in ("mujoco", "diffusion"):
        renderer = make_renderer(name, scene)
        rows.append([renderer.render(s, camera="side", height=128, width=128) for s in states])
        renderer.close()
    rows.append(list(difference(*rows)))
    iio.imwrite(path, np.concatenate([np.concatenate(row, axis=1) for row in rows]))


if __name__ == "__main__":
    sys.exit(main())
