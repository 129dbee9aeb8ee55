"""`Diagnosis`: what was found, and its files."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from orbisim.recording.joints import Kind, joints
from orbisim.recording.sensors import sensors
from orbisim.scene import Scene

if TYPE_CHECKING:
    from orbisim.diagnosis.conclusion import Attribution
    from orbisim.diagnosis.force_search import ForceAttribution
    from orbisim.diagnosis.rest import Rest
    from orbisim.diagnosis.sensing import Sensed
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
      error_unit: unit of the errors in `evidence` where they are of a sensor's own readings (root
        mean square); empty where they are the free-running error.
    """

    effect: str
    target: str
    parameters: Mapping[str, Estimate]
    native: bool
    evidence: Mapping[str, float]
    options: Mapping[str, str]
    error_unit: str = ""


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another explanation. delta_bic: how much worse it is. reason: why it was not chosen, and what
    to record to be sure."""

    effect: str
    target: str
    delta_bic: float | None
    reason: str


@dataclasses.dataclass(frozen=True)
class Candidate:
    """An effect that was tried.

    Attributes:
      effect, target: as in the catalogue.
      round: of the search; None if it could not be judged.
      ratio: residual over noise that it leaves.
      delta_bic: how much worse than the best of its round.
      reason: why it was not taken; empty if it was.
    """

    effect: str
    target: str
    round: int | None
    ratio: float | None
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
      candidates: what was tried, each with the reason why it was not taken.
      sensors: what became of sensors that do not read the joints themselves.
      rest: a learned force for what is left, if it was asked for; it is no effect.
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

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        from orbisim.diagnosis.wording import sentence

        return sentence(self)

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
            "alternatives": [dataclasses.asdict(one) for one in self.alternatives],
            "candidates": [dataclasses.asdict(one) for one in self.candidates],
            "error": dict(self.error),
            "augmented_scene": "augmented/scene.xml",
            "rest": None if self.rest is None else self.rest.to_json(),
            "notes": list(self.notes),
        }
        return {key: _strict(value) for key, value in plain.items()}

    def report(self, path: str | Path) -> Path:
        """Writes the HTML page to `path`; returns it."""
        from orbisim.report.diagnosis import write_report

        return write_report(self, Path(path))

    def save(self, folder: str | Path) -> Path:
        """Writes `report.json`, `report.html` and `augmented/scene.xml` with its files; and, where
        a residual force was learned, `augmented_with_rest/scene.xml`."""
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        self.augmented_scene.save(out / "augmented")
        if self.rest is not None and self.rest.scene is not None:
            self.rest.scene.save(out / "augmented_with_rest")
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
