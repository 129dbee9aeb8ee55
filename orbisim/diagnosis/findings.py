"""What a search has found, in the terms of a report."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np

from orbisim.backend import Backend
from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.explanations import enough
from orbisim.diagnosis.found import Retuned, Verdict
from orbisim.diagnosis.scoring import score
from orbisim.diagnosis.settings import Settings
from orbisim.effects import find
from orbisim.effects.estimate import Estimate, FoundEffect
from orbisim.evidence import NEAR
from orbisim.recording import Recording
from orbisim.recording.joints import joints
from orbisim.replay import Replay
from orbisim.scene import Scene
from orbisim.sensing.faults import Sensed
from orbisim.shooting.bench import Bench, Noise
from orbisim.shooting.confidence import confidence
from orbisim.shooting.fits import Fit
from orbisim.shooting.hypothesis import Hypothesis


def verdict_of(found: Attribution, settings: Settings) -> Verdict:
    """The verdict, by what is left of the residual.

    Effects explain what they bring to the white noise. That what they leave shows no structure does
    not say that they are all: it is a note.
    """
    hypothesis, least = found.hypothesis, max(NEAR, enough(settings, found.before))
    if not hypothesis.effects and not hypothesis.factors:
        return "unexplained" if _significant(found, settings) else "no_residual"
    if found.after.ratio <= least:
        return "explained"
    return "partly_explained" if hypothesis.effects else "unexplained"


def _significant(found: Attribution, settings: Settings) -> bool:
    """Whether the declared scene leaves more than noise, white or not; where the time was up, more
    than white noise, in any window: that no effect explains what is left, or what is off in a few,
    was not found out then. A late sensor leaves what noise of a slow course may leave, too."""
    before, whole = found.before, not found.cut_short
    noise = whole and found.left is not None and not found.left.structured
    left = before.ratio if whole else max(before.ratio, before.pooled)
    return not noise and left > max(NEAR, enough(settings, before))


def residual_of(found: Attribution, settings: Settings) -> dict[str, Any]:
    """Whether there is one, how large it is, and at which joints."""
    model = found.bench.scene.model
    where: list[dict[str, Any]] = []
    if found.first is not None:
        shares = found.first.shares
        for joint in joints(model):
            share = float(shares[joint.v].sum())
            if share >= 0.01:
                where.append({"target": joint.label, "share": share})
    changed = found.after is not found.before
    return {
        "significant": bool(changed or _significant(found, settings)),
        "ratio_to_noise": found.before.ratio,
        "ratio_after": found.after.ratio,
        "where": sorted(where, key=lambda w: -w["share"]),
    }


def verdict_with_sensors(motion: Verdict, sensed: Sensed) -> Verdict:
    """The verdict on motion and sensors from that on the motion."""
    left = sensed.unexplained
    if motion == "no_residual" and not sensed.effects:
        return "unexplained" if left else "no_residual"
    if motion in ("no_residual", "explained"):
        return "partly_explained" if left else "explained"
    return "partly_explained" if sensed.effects else motion


def honest(verdict: Verdict, error: dict[str, Any], notes: list[str]) -> Verdict:
    """A verdict that held-out recordings do not contradict: where free runs from measured starts
    are further off there with what was found than without, it does not explain everything,
    whatever it left of the windows that it was chosen by. What was found stays.

    Args:
      error: as reported. notes: get the reason.
    """
    before, after = error["held_out"]["before"], error["held_out"]["after"]
    if verdict != "explained" or not after > before:
        return verdict
    notes.append(
        f"on held-out data free runs are further off with what was found ({after:.3g} "
        f"{error['unit']} instead of {before:.3g}): it does not explain everything"
    )
    return "partly_explained"


def with_sensors(residual: dict[str, Any], sensed: Sensed) -> dict[str, Any]:
    """The residual of the motion together with that of the sensors' readings."""
    if not sensed.findings:
        return residual
    listed = [
        {
            "target": one.sensor.label,
            "unit": one.sensor.unit,
            "ratio_to_noise": one.before,
            "ratio_after": one.after,
        }
        for one in sensed.findings
    ]
    significant = residual["significant"] or sensed.significant or bool(sensed.effects)
    found = {**residual, "significant": significant, "sensors": listed}
    if not residual["significant"] and significant:
        excess = {o.sensor.label: max(o.before**2 - 1.0, 0.0) for o in sensed.findings}
        whole = max(sum(excess.values()), 1e-300)
        shares = sorted(((part / whole, name) for name, part in excess.items()), reverse=True)
        found["where"] = [{"target": n, "share": share} for share, n in shares if share >= 0.01]
    return found


def sensor_noise_of(sensed: Sensed) -> dict[str, float]:
    """Standard deviation of the noise of each sensor's readings."""
    return {f"sensor/{one.sensor.label}": one.noise for one in sensed.findings}


def noise_of(scene: Scene, noise: Noise) -> dict[str, float]:
    """Standard deviation of the measurement noise by signal.

    Args:
      noise: of positions and velocities, each [nv].
    """
    found: dict[str, float] = {}
    q_noise, v_noise = noise
    for joint in joints(scene.model):
        for kind, levels in (("qpos", q_noise), ("qvel", v_noise)):
            seen = levels[joint.v]
            seen = seen[np.isfinite(seen)]
            if seen.size:
                found[f"{kind}/{joint.label}"] = float(np.sqrt(np.mean(seen**2)))
    return found


def errors_of(
    before: dict[str, Replay], after: dict[str, Replay], bench: Bench, window: float
) -> dict[str, Any]:
    """Free-running error before and after, and what the noise alone would give."""
    model = bench.scene.model
    kinds = {int(j.kind) for j in joints(model)}
    q_noise = bench.noise[0]
    floor = 0.0
    for joint in joints(model):
        straight = slice(joint.v.start, joint.v.start + 3) if not joint.scalar else joint.v
        seen = q_noise[straight]
        floor += float(np.nansum(seen**2))
    linear = kinds <= {int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
    angular = kinds <= {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL)}
    return {
        "metric": "root mean squared norm of the free-running error over joint positions",
        "unit": "m" if linear else "rad" if angular else "SI (rad, m)",
        "window_s": window,
        "fit": {"before": before["fit"].rms, "after": after["fit"].rms},
        "held_out": {"before": before["held_out"].rms, "after": after["held_out"].rms},
        "noise_floor": float(np.sqrt(floor)),
        "windows": {kind: len(found.windows) for kind, found in before.items()},
    }


def effects_of(
    scene: Scene,
    hypothesis: Hypothesis,
    fit: Fit,
    evidence: Sequence[float],
    error: Callable[[Hypothesis], float],
    seed: int,
    independent: float = np.inf,
) -> tuple[FoundEffect, ...]:
    """The effects with their intervals and what each brings on held-out data.

    Args:
      scene: as declared. fit: of the hypothesis. evidence: drop in information criterion by effect.
      error: held-out error of a hypothesis. seed: of the bootstrap.
      independent: how many of the data that were fitted count as independent.
    """
    free = hypothesis.free(scene)
    names = [f"{i}.{name}" for i, name in free] + [str(one) for one, _ in hypothesis.factors]
    intervals = confidence(fit, names, seed, independent)
    with_all = error(hypothesis) if hypothesis.effects else 0.0
    result: list[FoundEffect] = []
    for i, effect in enumerate(hypothesis.effects):
        kind = find(effect.effect)
        parameters, units = {}, kind.units(scene.model, effect)
        for p in kind.parameters(scene.model, effect.target):
            value = float(effect.values[p.name])
            ci = intervals.get(f"{i}.{p.name}")
            if ci is None:
                ci = _propagated(scene, hypothesis, i, p.name, intervals)
            parameters[p.name] = Estimate(value, units[p.name], ci)
        result.append(
            FoundEffect(
                effect.effect,
                effect.target,
                parameters,
                kind.native,
                {
                    "held_out_error_without": error(hypothesis.without(i)),
                    "held_out_error_with": with_all,
                    "delta_bic": evidence[i],
                },
                dict(effect.options),
            )
        )
    return tuple(result)


def free_run_error(
    scene: Scene, held: Sequence[Recording], window: float, backend: str | Backend
) -> Callable[[Hypothesis], float]:
    """The free-running error of hypotheses on recordings."""

    def error(hypothesis: Hypothesis) -> float:
        return score(hypothesis.scene(scene), held, window, hypothesis.effects, backend).rms

    return error


def _propagated(
    scene: Scene,
    hypothesis: Hypothesis,
    number: int,
    name: str,
    intervals: dict[str, tuple[float, float]],
) -> tuple[float, float]:
    """The interval of a parameter that follows from the free ones, to first order; not a number
    where it follows from none: what was not fitted has no interval. So it is where it follows from
    one, too, that the data do not determine: the size of a force in the plane of an arm says
    nothing of the whole force's."""
    value = float(hypothesis.effects[number].values[name])
    if _undetermined(scene, hypothesis, number, name):
        return np.nan, np.nan
    values, variance = hypothesis.values(scene), 0.0
    for index, (i, free) in enumerate(hypothesis.free(scene)):
        if i != number:
            continue
        low, high = intervals[f"{i}.{free}"]
        half = (high - low) / 2
        moved = values.copy()
        moved[index] += half
        other = hypothesis.at(scene, moved).effects[number].values[name]
        variance += (float(other) - value) ** 2
    half = float(np.sqrt(variance)) or np.nan
    return value - half, value + half


def _undetermined(scene: Scene, hypothesis: Hypothesis, number: int, name: str) -> bool:
    """Whether a parameter of an effect changes with one that the data do not determine."""
    value = hypothesis.effects[number].values[name]
    every = dataclasses.replace(hypothesis, frozen=frozenset())
    values, unknowns = every.values(scene), every.unknowns(scene)
    for k, one in enumerate(every.free(scene)):
        if one[0] == number and one in hypothesis.frozen:
            moved = values.copy()
            moved[k] += _FAR * unknowns[k].step_from(float(values[k]))
            if every.at(scene, moved).effects[number].values[name] != value:
                return True
    return False


_FAR = 1e4
"""Difference steps: to first order, a component that is 0 does not change the size of a vector."""


def retuned_of(scene: Scene, found: Attribution) -> tuple[Retuned, ...]:
    """Declared parameters that are clearly off."""
    hypothesis = found.after.hypothesis
    first = len(hypothesis.free(scene))
    spread = np.sqrt(np.maximum(np.diag(found.after.fit.covariance), 0.0))
    result = []
    for f, (one, factor) in enumerate(hypothesis.factors):
        half = 1.96 * float(spread[first + f])
        if abs(factor - 1) > max(half, 2e-3):
            result.append(Retuned(str(one), factor, (factor - half, factor + half)))
    return tuple(result)
