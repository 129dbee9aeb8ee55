"""`Diagnosis`: what was found, and its files."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from orbisim.scene import Scene

if TYPE_CHECKING:
    from orbisim.diagnosis.attribution import Attribution
    from orbisim.diagnosis.force_search import ForceAttribution
    from orbisim.recording import Recording

SCHEMA = "orbisim.diagnosis/1"

Verdict = Literal["no_residual", "explained", "partly_explained", "unexplained"]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A parameter. value: SI. unit: its unit. ci95: its 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class FoundEffect:
    """An effect that the scene lacks.

    Attributes:
      effect, target: as in the catalogue. parameters: the first is the one to quote.
      native: whether it is native MJCF in the augmented scene.
      evidence: `held_out_error_without`, `held_out_error_with`, `delta_bic`.
      options: choices that are not numbers.
    """

    effect: str
    target: str
    parameters: Mapping[str, Estimate]
    native: bool
    evidence: Mapping[str, float]
    options: Mapping[str, str]


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another explanation. delta_bic: how much worse it is. reason: why it was not chosen, and what
    to record to be sure."""

    effect: str
    target: str
    delta_bic: float | None
    reason: str


@dataclasses.dataclass(frozen=True)
class Retuned:
    """A declared parameter that is off. factor: true over declared. ci95: of the factor."""

    label: str
    factor: float
    ci95: tuple[float, float]


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

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        from orbisim.diagnosis.wording import sentence

        return sentence(self)

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
            "residual": dict(self.residual),
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": [dataclasses.asdict(effect) for effect in self.effects],
            "retuned": [dataclasses.asdict(one) for one in self.retuned],
            "alternatives": [dataclasses.asdict(one) for one in self.alternatives],
            "error": dict(self.error),
            "augmented_scene": "augmented/scene.xml",
            "notes": list(self.notes),
        }
        return {key: _strict(value) for key, value in plain.items()}

    def report(self, path: str | Path) -> Path:
        """Writes the HTML page to `path`; returns it."""
        from orbisim.report.diagnosis import write_report

        return write_report(self, Path(path))

    def save(self, folder: str | Path) -> Path:
        """Writes `report.json`, `report.html` and `augmented/scene.xml` with its files."""
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        self.augmented_scene.save(out / "augmented")
        text = json.dumps(self.to_json(), indent=1, allow_nan=False)
        (out / "report.json").write_text(text + "\n", encoding="utf-8")
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
