"""A diagnosis by the residual in force space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.alternatives import known_alike, suspected
from orbisim.diagnosis.combinations import combined_in_forces
from orbisim.diagnosis.findings import effects_of, noise_of
from orbisim.diagnosis.force_search import ForceAttribution, attribute_forces
from orbisim.diagnosis.found import Alternative, Verdict
from orbisim.diagnosis.result import Diagnosis
from orbisim.diagnosis.settings import Settings
from orbisim.evidence import NEAR
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.force import force_residual
from orbisim.motion.samples import Samples, prepare_all
from orbisim.recording import Recording
from orbisim.recording.joints import Joint, joints
from orbisim.scene import Scene
from orbisim.shooting.hypothesis import Hypothesis

Floats = npt.NDArray[np.float64]

METRIC = (
    "root mean squared norm of the generalized force that the scene does not account for, by "
    "inverse dynamics along the measured motion"
)


def diagnose_forces(
    scene: Scene,
    source: str,
    fit: Sequence[Recording],
    held: Sequence[Recording],
    settings: Settings,
    backend: str,
    notes: Sequence[str],
    say: Callable[[str], None],
    deadline: Deadline = NEVER,
) -> Diagnosis:
    """As `orbisim.diagnose` with `residual="force"`; recordings are bounded and not thinned.

    Raises:
      RecordingError: a recording does not fit the scene.
      InputError: there are too few usable samples.
    """
    bare = scene.without_images()
    samples, unseen = prepare_all(fit, bare), prepare_all(held, bare)
    found = attribute_forces(bare, samples, settings, say, deadline)
    if deadline.passed:
        notes = [*notes, "the search was ended as its time was up; more may be found"]
    say("checking on held-out data")
    fitted, kept = _Errors(bare, samples), _Errors(bare, unseen)
    return Diagnosis(
        scene=scene,
        source=source,
        backend=backend,
        fit=tuple(fit),
        held_out=tuple(held),
        noise=noise_of(scene, (samples[0].q_noise, samples[0].v_noise)),
        residual=_residual(scene, found, settings),
        verdict=_verdict(found, settings),
        effects=effects_of(
            scene, found.hypothesis, found.fit, found.evidence, kept.of, settings.seed
        ),
        alternatives=_alternatives(found),
        retuned=(),
        error=_error(scene, found, fitted, kept),
        augmented_scene=found.hypothesis.scene(scene),
        notes=tuple(dict.fromkeys([*notes, *_implausible(scene, found)])),
        attribution=found,
        combinations=combined_in_forces(found, settings),
    )


def _implausible(scene: Scene, found: ForceAttribution) -> list[str]:
    """Notes on joints whose noise would be as large as the forces of the machine itself."""
    data, notes = found.data, []
    noise = np.sqrt(np.nanmean(data.std**2, axis=0))
    needed = np.sqrt(np.nanmean(data.total**2, axis=0))
    for joint in joints(scene.model):
        own, whole = (float(np.linalg.norm(one[joint.v])) for one in (noise, needed))
        if own > whole:
            notes.append(
                f"the noise of {joint.label!r} would be a force of {own:.3g} where its motion "
                f"needs {whole:.3g}: positions jump, or time stamps do; rows that are known so "
                "badly hardly count"
            )
    return notes


class _Errors:
    """Missing force of hypotheses along recordings."""

    def __init__(self, scene: Scene, samples: Sequence[Samples]) -> None:
        self._scene, self._samples = scene, samples

    def by_dof(self, hypothesis: Hypothesis, field: str = "force") -> Floats:
        """[nv]: root mean square."""
        parts = force_residual(self._samples, hypothesis.scene(self._scene))
        values = np.concatenate([getattr(part, field) for part in parts])
        return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))

    def of(self, hypothesis: Hypothesis) -> float:
        """Root mean squared norm."""
        return float(np.linalg.norm(self.by_dof(hypothesis)))


def _verdict(found: ForceAttribution, settings: Settings) -> Verdict:
    if not found.hypothesis.effects:
        return "unexplained" if found.ratio > settings.enough else "no_residual"
    return "explained" if found.ratio_after <= NEAR else "partly_explained"


def _residual(scene: Scene, found: ForceAttribution, settings: Settings) -> dict[str, Any]:
    square = np.nanmean(found.data.force**2, axis=0)
    shares = square / max(float(square.sum()), 1e-300)
    each = {joint.label: float(shares[joint.v].sum()) for joint in joints(scene.model)}
    order = sorted(each, key=lambda label: -each[label])
    return {
        "significant": bool(found.hypothesis.effects or found.ratio > settings.enough),
        "ratio_to_noise": found.ratio,
        "ratio_after": found.ratio_after,
        "where": [{"target": j, "share": each[j]} for j in order if each[j] >= 0.01],
    }


def _alternatives(found: ForceAttribution) -> tuple[Alternative, ...]:
    """Suspects with their probabilities, and effects that are known to look like those found."""
    listed = suspected(found.suspects)
    return (*listed, *known_alike([e.effect for e in found.hypothesis.effects], listed))


def _error(scene: Scene, found: ForceAttribution, fitted: _Errors, kept: _Errors) -> dict[str, Any]:
    nothing, after = Hypothesis(), found.hypothesis
    before_by, after_by = kept.by_dof(nothing), kept.by_dof(after)
    every = joints(scene.model)
    return {
        "metric": METRIC,
        "name": "missing force",
        "residual": "force",
        "unit": _unit(every),
        "window_s": 0.0,
        "fit": {"before": fitted.of(nothing), "after": fitted.of(after)},
        "held_out": {
            "before": float(np.linalg.norm(before_by)),
            "after": float(np.linalg.norm(after_by)),
        },
        "held_out_by_joint": {
            joint.label: {
                "before": float(np.linalg.norm(before_by[joint.v])),
                "after": float(np.linalg.norm(after_by[joint.v])),
            }
            for joint in every
        },
        "noise_floor": float(np.linalg.norm(kept.by_dof(nothing, "std"))),
        "windows": {"fit": found.data.blocks, "held_out": 0},
    }


def _unit(every: Sequence[Joint]) -> str:
    kinds = {int(joint.kind) for joint in every}
    turning = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL)}
    if kinds <= turning:
        return "N*m"
    return "N" if kinds <= {int(mujoco.mjtJoint.mjJNT_SLIDE)} else "SI (N*m, N)"
