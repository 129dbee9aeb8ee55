"""Makes the example recordings of `mjcf_assets/arm2/example`: an arm whose elbow has Coulomb
friction that its scene does not declare.

    python tools/make_example.py
"""

from __future__ import annotations

from pathlib import Path

import orbisim
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

ARM = Path(__file__).resolve().parent.parent / "mjcf_assets" / "arm2"
HIDDEN = EffectInstance("coulomb_friction", "elbow", {"torque": 0.12})


def main() -> None:
    scene = orbisim.load_scene(ARM / "scene.xml")
    (ARM / "example").mkdir(exist_ok=True)
    recordings = inject_effect(scene, HIDDEN, noise=2e-4, episodes=4, duration=6.0, seed=7)
    for number, recording in enumerate(recordings, 1):
        recording.save(ARM / "example" / f"run{number}.npz")


if __name__ == "__main__":
    main()
