"""What a policy for a machine can be trained in."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import orbisim
from orbisim.diagnosis.settings import Settings
from orbisim.effects.carry import add_effects
from orbisim.files.reading import read_json
from orbisim.files.writing import make_folder
from orbisim.recording import Recording
from orbisim.scene import Scene, load_scene
from orbisim.testing import inject_effect
from paying.cart import Balance
from paying.duty import Duty
from paying.hop import Hop
from paying.reach import Reach
from paying.shove import Shove

DUTIES: Mapping[str, type[Duty]] = {
    "cart_pole": Balance,
    "arm": Reach,
    "push": Shove,
    "leg": Hop,
}
CONDITIONS = ("declared", "randomised", "hybrid", "diagnosed", "true")
RECORDINGS = 4
"""Of the machine, for a diagnosis and for a correction that is learned."""
_RATE = 100.0
"""Hz, of recordings, and of the corrected steps."""
_HYBRID = {
    "model.width": 64,
    "model.layers": 2,
    "train.precision": "fp32",
    "train.stages": "1x1x512",
}
"""Small, for 3,200 control steps of data and one processor."""

Place = tuple[Duty, dict[str, Any]]
"""Where to train, and what is known of it."""


def machine(duty: type[Duty]) -> Scene:
    """The machine's own scene, which nobody has."""
    return add_effects(duty.declared(), duty.effects)


def recordings(duty: type[Duty], seed: int, folder: Path) -> list[Recording]:
    """Four recordings of the machine, kept in a folder."""
    paths = [folder / f"run{i}.npz" for i in range(RECORDINGS)]
    if not all(path.exists() for path in paths):
        make_folder(folder)
        made = inject_effect(
            duty.declared(), duty.effects, rate=_RATE, episodes=RECORDINGS, seed=seed
        )
        for path, one in zip(paths, made, strict=True):
            one.save(path)
    return [Recording.load(path) for path in paths]


def declared(duty: type[Duty], seed: int, folder: Path, seconds: float) -> Place:
    """The scene as declared."""
    return duty(), {}


def randomised(duty: type[Duty], seed: int, folder: Path, seconds: float) -> Place:
    """Scenes drawn widely, without a diagnosis."""
    return duty(seed=seed), {}


def true(duty: type[Duty], seed: int, folder: Path, seconds: float) -> Place:
    """The machine itself."""
    return duty(machine(duty)), {}


def diagnosed(duty: type[Duty], seed: int, folder: Path, seconds: float) -> Place:
    """The scene with what a diagnosis finds; a folder that holds one is read.

    Args:
      duty: of which machine. seed: of recordings and search. folder: for both.
      seconds: patience of the diagnosis.
    """
    where = folder / "diagnosis"
    if not (where / "report.json").exists():
        began = time.monotonic(), time.process_time()
        measured = recordings(duty, seed, folder)
        settings = Settings(seed=seed, patience=seconds)
        found = orbisim.diagnose(duty.declared(), measured, settings=settings, progress=False)
        spent = time.monotonic() - began[0], time.process_time() - began[1]
        found.save(where)
        (folder / "seconds.txt").write_text(f"{spent[0]:.1f} {spent[1]:.1f}\n")
    report = read_json(where / "report.json")
    effects = [
        {
            "effect": one["effect"],
            "target": one["target"],
            "parameters": {n: p["value"] for n, p in one["parameters"].items()},
        }
        for one in report["effects"]
    ]
    wall, processor = map(float, (folder / "seconds.txt").read_text().split())
    notes = {"verdict": report["verdict"], "effects": effects}
    notes |= {"diagnosis_s": wall, "diagnosis_processor_s": processor}
    return duty(load_scene(where / report["augmented_scene"])), notes


def hybrid(duty: type[Duty], seed: int, folder: Path, seconds: float) -> Place:
    """The declared scene, with a correction of MuJoCo's step learned from the same recordings.

    Args:
      duty: of which machine. seed: of recordings and training. folder: for both.
      seconds: at most, of the correction's training.
    """
    from orbisim_world_model.config import replaced
    from orbisim_world_model.packing import read_data
    from orbisim_world_model.presets import preset
    from orbisim_world_model.run import Run, train

    where, notes = folder / "hybrid", {}
    if not (where / "manifest.json").exists():
        recordings(duty, seed, folder)
        scene = duty.declared().save(folder / "declared")
        paths = [folder / f"run{i}.npz" for i in range(RECORDINGS)]
        pack = read_data(paths, scene=str(scene), timestep=1 / _RATE, baseline="mujoco")
        run = Run(where, limit=seconds, seed=seed)
        train(pack, replaced(preset("hybrid"), _HYBRID), run)
    notes = {"training": read_json(where / "manifest.json").get("training", {})}
    return duty(backend=f"hybrid:{where}"), notes


PLACES: Mapping[str, Callable[[type[Duty], int, Path, float], Place]] = {
    "declared": declared,
    "randomised": randomised,
    "hybrid": hybrid,
    "diagnosed": diagnosed,
    "true": true,
}
