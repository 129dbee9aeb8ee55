"""`Diagnosis`: what was found, and its files."""

from __future__ import annotations

import dataclasses
import functools
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from orbisim import plugins
from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.force_search import ForceAttribution
from orbisim.diagnosis.found import Alternative, Candidate, Combination, Retuned, Verdict
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.wording import sentence
from orbisim.effects.carry import save_with_effects
from orbisim.effects.estimate import FoundEffect
from orbisim.files.writing import make_folder, write_json, write_text
from orbisim.learned_rest.result import Rest
from orbisim.recording import Recording
from orbisim.recording.joints import Kind, joints
from orbisim.recording.origin import digest_of_source, files_of
from orbisim.recording.sensors import sensors
from orbisim.scene import Scene
from orbisim.scene.patch import Patch, patch_of
from orbisim.scene.query import without_options
from orbisim.sensing.faults import Sensed
from orbisim.shooting.history import HistoryDependent
from orbisim.version import VERSION

SCHEMA = "orbisim.diagnosis/1"
PATCH = "patch.diff"
"""Beside the augmented scene: apply it with `patch -p1` in the folder of the user's own."""


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of `orbisim.diagnose`.

    Attributes:
      scene: the declared scene. source: as the user named it. backend: what ran the residual.
      fit, held_out: the recordings (or stretches) that were and were not seen.
      noise: standard deviation of the measurement noise by signal.
      residual: `significant`, `ratio_to_noise`, `where`.
      verdict: as in contracts.
      effects, alternatives, retuned: what was found.
      error: free-running error before and after, `fit` and `held_out`.
      augmented_scene: the scene with the effects.
      notes: what was ignored, assumed or looks wrong.
      attribution: the search behind it.
      candidates: what was tried, each with the reason why it was not taken.
      sensors: what became of sensors that do not read the joints themselves.
      settings: how the search went about it, as it was told.
      rest: a learned force for what is left, if it was asked for; it is no effect.
      history: joints that no function of the recorded state explains, where something is left.
      combinations: what is determined of effects' numbers that are not themselves.
    """

    scene: Scene
    source: str
    backend: str
    fit: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    noise: Mapping[str, float]
    residual: Mapping[str, Any]
    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    alternatives: tuple[Alternative, ...]
    retuned: tuple[Retuned, ...]
    error: Mapping[str, Any]
    augmented_scene: Scene
    notes: tuple[str, ...]
    attribution: Attribution | ForceAttribution
    rest: Rest | None = None
    candidates: tuple[Candidate, ...] = ()
    sensors: Sensed | None = None
    settings: Settings = dataclasses.field(default_factory=Settings)
    history: tuple[HistoryDependent, ...] = ()
    combinations: tuple[Combination, ...] = ()

    @property
    def sentence(self) -> str:
        """The verdict in one sentence, and one for each joint that depends on its history."""
        verdict = sentence(
            verdict=self.verdict,
            effects=self.effects,
            retuned=self.retuned,
            error=self.error,
            residual=self.residual,
            of_sensors=self.error_is_of_sensors,
            cut_short=getattr(self.attribution, "cut_short", False),
        )
        return " ".join([verdict, *(f"{one.told}." for one in self.history)])

    @property
    def error_is_of_sensors(self) -> bool:
        """Whether the motion is predicted to within the noise and readings of sensors are not."""
        return self.sensors is not None and self.sensors.significant

    @property
    def noise_units(self) -> dict[str, str]:
        """Unit of each noise level."""
        known = {
            f"{kind}/{joint.label}": f"{unit}{per}"
            for joint in joints(self.scene.model)
            for kind, per in (("qpos", ""), ("qvel", "/s"))
            for unit in [joint.unit if joint.scalar or joint.kind == Kind.FREE else "rad"]
        }
        known |= {f"sensor/{one.label}": one.unit for one in sensors(self.scene.model)}
        return {name: known[name] for name in self.noise}

    def to_json(self) -> dict[str, Any]:
        """The result as contracts.md, section 3, has it; infinite and unknown numbers are None."""
        plain: dict[str, Any] = {
            "schema": SCHEMA,
            "scene": self.source,
            "backend": self.backend,
            "recordings": {
                "fit": [one.source for one in self.fit],
                "held_out": [one.source for one in self.held_out],
            },
            "noise": dict(self.noise),
            "noise_units": self.noise_units,
            "residual": dict(self.residual),
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": [dataclasses.asdict(effect) for effect in self.effects],
            "retuned": [dataclasses.asdict(one) for one in self.retuned],
            "combinations": [dataclasses.asdict(one) for one in self.combinations],
            "alternatives": [dataclasses.asdict(one) for one in self.alternatives],
            "candidates": [dataclasses.asdict(one) for one in self.candidates],
            "error": dict(self.error),
            "augmented_scene": "augmented/scene.xml",
            "patch": f"augmented/{PATCH}" if self.patch.text else None,
            "no_patch": self.patch.problem or None,
            "history_dependent": [dataclasses.asdict(one) for one in self.history],
            "rest": None if self.rest is None else self.rest.to_json(),
            "notes": list(self.notes),
            "origin": self.origin,
        }
        return {key: _strict(value) for key, value in plain.items()}

    @functools.cached_property
    def patch(self) -> Patch:
        """What to change in the user's own MJCF files."""
        return patch_of(self.scene, self.augmented_scene)

    @functools.cached_property
    def origin(self) -> dict[str, Any]:
        """What the result was made from: versions, and SHA-256 of the files of recordings, of the
        scene's file, and of the model that it compiles to (which holds what the file includes)."""
        names = [one.source for one in (*self.fit, *self.held_out)]
        digests = {name: digest_of_source(name) for name in files_of(names)}
        return {
            "versions": {
                "orbisim": VERSION,
                "mujoco": mujoco.__version__,
                "numpy": np.__version__,
                "python": platform.python_version(),
            },
            "scene": {
                "sha256": digest_of_source(without_options(self.source)[0]),
                "model_sha256": self.scene.fingerprint,
            },
            "sha256": {name: one for name, one in digests.items() if one is not None},
        }

    def report(self, path: str | Path) -> Path:
        """Writes the HTML page to `path`; returns it."""
        page: Path = plugins.load("orbisim.reports", "diagnosis", "report")(self, Path(path))
        return page

    def save(self, folder: str | Path) -> Path:
        """Writes `report.json`, `report.html` and `augmented/scene.xml` with its files and with
        `effects.py` for plain MuJoCo; `augmented/patch.diff` for the user's own MJCF, where it can
        be patched; and, where a residual force was learned, `augmented_with_rest/scene.xml`."""
        out = make_folder(folder)
        save_with_effects(self.augmented_scene, out / "augmented")
        if self.patch.text:
            write_text(out / "augmented" / PATCH, self.patch.text)
        if self.rest is not None and self.rest.scene is not None:
            save_with_effects(self.rest.scene, out / "augmented_with_rest")
        write_json(out / "report.json", self.to_json())
        self.report(out / "report.html")
        return out


def _strict(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _strict(v) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_strict(v) for v in value]
    if isinstance(value, (np.floating, float)):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.generic):
        return value.item()
    return value
