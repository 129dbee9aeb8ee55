"""Recordings of twelve two-joint arms as built, three of which have a fault.

    python tools/fleet_example.py fleet
    orbisim diagnose mjcf_assets/arm2/scene.xml --fleet fleet --out fleet-diagnosis

Every arm has Coulomb friction of about 0.1 N*m at the shoulder that the scene does not declare,
within 5 %. Beside that, arm03's elbow drags (a worn gear), arm07's elbow encoder was mounted
0.04 rad off, and arm10 still carries 0.15 kg at its tip.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import from_source

SCENE = Path(__file__).resolve().parent.parent / "mjcf_assets" / "arm2" / "scene.xml"
ARMS, EPISODES, DURATION = 12, 4, 5.0
NOISE = 3e-4
"""Of positions, rad: an encoder of about 20,000 counts."""
FAULTS = {
    3: ("coulomb_friction", "elbow", {"torque": 0.12}),
    7: ("sensor_bias", "elbow", {"offset": 0.04}),
    10: ("payload", "forearm", {"mass": 0.15, "com_x": 0.0, "com_y": 0.0, "com_z": -0.25}),
}


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, help="folder; gets a folder for each arm")
    args = parser.parse_args(argv)
    from_source.register("mujoco")
    from orbisim import load_scene
    from orbisim.effects import EffectInstance
    from orbisim.testing import inject_effect

    scene, rng = load_scene(SCENE), np.random.default_rng(12)
    for arm in range(1, ARMS + 1):
        level = 0.1 * (1 + 0.05 * rng.uniform(-1, 1))
        effects = [EffectInstance("coulomb_friction", "shoulder", {"torque": level})]
        if arm in FAULTS:
            effects.append(EffectInstance(*FAULTS[arm]))
        found = inject_effect(
            scene, effects, duration=DURATION, episodes=EPISODES, noise=NOISE, seed=arm
        )
        folder = args.out / f"arm{arm:02d}"
        folder.mkdir(parents=True, exist_ok=True)
        for number, one in enumerate(found):
            one.save(folder / f"run{number}.npz")
    print(f"{ARMS} arms in {args.out}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
