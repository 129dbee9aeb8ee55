"""Makes the moving pictures of docs/gallery.md, from the commands that stand beside them there.

    python tools/gallery.py                        # all of them (minutes), into docs/images/gallery
    python tools/gallery.py policies cloth         # some
    python tools/gallery.py --commands             # prints what each is made of

A picture is one row of panels, each the video of one command of `orbisim`; nothing is drawn that a
command did not simulate. They are written as animated WebP, which browsers show where a page has a
picture.
"""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

Frames = npt.NDArray[np.uint8]

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs" / "images" / "gallery"
FPS = 10
MOST_BYTES = 150_000
"""Of one picture: a page of ten loads in a moment."""
QUALITY = 60
"""Of WebP; below, edges of thin limbs begin to swim."""
SIZE = f"--size 120x160 --fps {FPS} --seed 0"


@dataclasses.dataclass(frozen=True)
class Panel:
    """One video. label: drawn on it. command: that makes it, but for `--out`."""

    label: str
    command: str


def _sim(scene: str, rest: str, renderer: str = "mujoco", size: str = SIZE) -> str:
    return " ".join(f"orbisim sim {scene} {rest} --renderer {renderer} {size}".split())


_CHEETAH = "--controls random --duration 2.5"
_PUSH = "--policy push --duration 3"
_SQUARE = f"--size 128x128 --fps {FPS} --seed 0"  # the only size that the checkpoint draws
_SLOW = "--size 120x160 --fps 2 --seed 0"  # shown five times as fast

PICTURES: dict[str, tuple[Panel, ...]] = {
    "engines": (
        Panel("C MuJoCo", _sim("suite:cheetah-run", _CHEETAH)),
        Panel("MuJoCo-Warp", _sim("suite:cheetah-run", f"{_CHEETAH} --backend warp")),
    ),
    "learned": (
        Panel("C MuJoCo", _sim("task:push", _PUSH)),
        Panel("learned", _sim("task:push", f"{_PUSH} --backend learned")),
    ),
    "diffusion": (
        Panel("MuJoCo", _sim("task:push", _PUSH, size=_SQUARE)),
        Panel("diffusion", _sim("task:push", _PUSH, "diffusion", _SQUARE)),
    ),
    "policies": (
        Panel("cartpole", _sim("suite:cartpole-swingup", "--policy cartpole --duration 4")),
        Panel("pendulum", _sim("suite:pendulum-swingup", "--policy pendulum --duration 4")),
    ),
    "pushing": (
        Panel("analytic gradients", _sim("task:push", "--policy push --duration 3.2")),
        Panel("PPO", _sim("task:push", "--policy push_ppo --duration 3.2")),
    ),
    "mechanisms": (
        Panel("door", _sim("task:mechanism:door", "--camera front --duration 14", size=_SLOW)),
        Panel("bottle", _sim("task:mechanism:bottle", "--camera side --duration 14", size=_SLOW)),
    ),
    "cloth": (Panel("drape", _sim("task:drape", "--duration 2")),),
}
"""By name of the file: the panels, from left to right."""


def frames_of(panel: Panel, folder: Path) -> Frames:
    """[T, height, width, 3]: of the video that a command makes in a folder."""
    _, *words = shlex.split(panel.command)
    program = [sys.executable, "-c", "from orbisim.cli import main; main()", *words]
    program += ["--out", str(folder)]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"error: {panel.command}: {done.stderr.strip()[-500:]}")
    return np.asarray(iio.imread(folder / "video.mp4"), np.uint8)


def side_by_side(videos: Sequence[Frames], labels: Sequence[str]) -> list[Image.Image]:
    """Frames of several videos of one height, each with its label; the shorter ones stop."""
    count = max(len(video) for video in videos)
    found = []
    for number in range(count):
        row = [video[min(number, len(video) - 1)] for video in videos]
        image = Image.fromarray(np.concatenate(row, axis=1))
        pen, left = ImageDraw.Draw(image), 0
        for part, label in zip(row, labels, strict=True):
            pen.text((left + 5, 3), label, "white", stroke_width=1, stroke_fill="black")
            left += part.shape[1]
        found.append(image)
    return found


def write(images: Sequence[Image.Image], path: Path, fps: float = FPS) -> int:
    """Writes an animated WebP that repeats, and returns its size in bytes.

    Raises:
      SystemExit: it is larger than `MOST_BYTES`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    first, *others = images
    first.save(
        path, save_all=True, append_images=others, duration=round(1000 / fps), loop=0,
        quality=QUALITY, method=6,
    )  # fmt: skip
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise SystemExit(f"error: {path}: {size} bytes are more than {MOST_BYTES}")
    return size


def make(name: str, out: Path) -> int:
    """Makes a picture; returns its size in bytes."""
    panels = PICTURES[name]
    with tempfile.TemporaryDirectory() as folder:
        videos = [frames_of(panel, Path(folder, str(i))) for i, panel in enumerate(panels)]
    return write(side_by_side(videos, [panel.label for panel in panels]), out / f"{name}.webp")


def main() -> None:
    """Makes what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help=f"some of {', '.join(PICTURES)}; default: all")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--commands", action="store_true", help="only prints them")
    options = parser.parse_args()
    if unknown := set(options.names) - set(PICTURES):
        parser.error(f"there is no {', '.join(sorted(unknown))}; known: {', '.join(PICTURES)}")
    for name in options.names or PICTURES:
        for panel in PICTURES[name]:
            print(f"{name}: {panel.command}", flush=True)
        if not options.commands:
            print(f"{name}: {make(name, options.out)} bytes", flush=True)


if __name__ == "__main__":
    main()
