"""How far mechanisms from USD move from where they move from URDF, under the same forces.

    python tools/mechanism_formats.py --instances 4

Every family, so many instances: both files are written, read by our readers, and moved for as many
timesteps by sinusoidal forces at all joints. Prints the greatest difference of joint positions,
beside how far the joints move, and whether effects are the same.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import carried_effects
from orbisim.files.temporary import temporary_folder
from orbisim.tasks.mechanisms.catalogue import FAMILIES, make
from orbisim.tasks.mechanisms.urdf import write_urdf
from orbisim.tasks.mechanisms.usd import write_usd

Floats = npt.NDArray[np.float64]
HELD = 20
"""Timesteps for which a force is held."""


def moved(scene: Scene, forces: Floats, names: list[str]) -> Floats:
    """Positions [T, J] of joints under forces [T, J] at them, `HELD` timesteps each."""
    engine, model = make_backend("mujoco", scene), scene.model
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    state, rows = engine.reset(), []
    for force in forces:
        applied = np.zeros((1, model.nv))
        applied[0, dofs] = force
        state = engine.step(state.with_memory(qfrc_applied=applied), None, HELD)
        rows.append(state.qpos[0][[int(model.joint(name).qposadr[0]) for name in names]])
    return np.array(rows)


def compared(family: str, number: int, times: int) -> dict[str, Any]:
    """One instance from both files."""
    mechanism = make(family, number)
    names = [joint.name for joint in mechanism.joints]
    with temporary_folder() as folder:
        scenes = [
            load_scene(write_urdf(mechanism, Path(folder)), trusted=True),
            load_scene(write_usd(mechanism, Path(folder))),
        ]
    push = 2.0 * np.sin(0.35 * np.arange(times))[:, None] + 1.0 + np.zeros(len(names))
    urdf, usd = (moved(scene, push, names) for scene in scenes)
    effects = [carried_effects(scene.model) for scene in scenes]
    return {
        "difference": float(np.abs(urdf - usd).max()),
        "travel": float(np.ptp(urdf, axis=0).max()),
        "effects": effects[0] == effects[1] == mechanism.effects,
    }


def main() -> None:
    """Prints a line of JSON for each family."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--instances", type=int, default=4)
    parser.add_argument("--times", type=int, default=150, help="forces, one after another")
    options = parser.parse_args()
    for family in FAMILIES:
        found = [compared(family, number, options.times) for number in range(options.instances)]
        line = {
            "family": family,
            "instances": len(found),
            "greatest_difference": max(one["difference"] for one in found),
            "travel": max(one["travel"] for one in found),
            "same_effects": all(one["effects"] for one in found),
        }
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
