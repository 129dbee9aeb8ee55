"""`make demo`: two backends on two scenes, and an arm whose scene lacks something: a table and a
report for each."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from orbisim.cli.main import run

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
    print(f"Done in {time.monotonic() - started:.0f} s. Open in a browser:")
    for name in (*(scene.partition(":")[2] for scene in SCENES), "diagnosis"):
        print(f"  {(OUT / name / 'report.html').resolve()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
