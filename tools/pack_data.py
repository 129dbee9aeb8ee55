"""Packs episode files for training on a machine without MuJoCo.

    python tools/pack_data.py push.h5 --out push.pack [--baseline mujoco]

A pack holds the states, controls and descriptors of one scene layout in single precision.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]


def main() -> int:
    """Writes one pack of all files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--baseline", choices=("none", "mujoco"), default="none")
    options = parser.parse_args()
    from orbisim_world_model.packing import read_data

    pack = read_data(options.data, baseline=options.baseline)
    pack.save(options.out)
    size = options.out.stat().st_size / 1e6
    print(f"{options.out}: {pack.episodes} episodes, {int(pack.length.sum())} steps, {size:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
