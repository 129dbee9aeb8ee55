"""`make demo`: two backends on two scenes, a table and a report for each."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from orbisim.cli.main import run

OUT = Path("out/demo")
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
    print(f"Done in {time.monotonic() - started:.0f} s. Open in a browser:")
    for scene in SCENES:
        print(f"  {(OUT / scene.partition(':')[2] / 'report.html').resolve()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
