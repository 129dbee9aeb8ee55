"""`orbisim.diagnose`: from a scene and recordings to the effects that the scene lacks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from orbisim.backend import Backend
from orbisim.diagnosis.attribution import Attribution, Settings, attribute, confidence, enough
from orbisim.diagnosis.bench import Bench, make_bench
from orbisim.diagnosis.confounds import advice, standing
from orbisim.diagnosis.result import Alternative, Diagnosis, Estimate, FoundEffect, Retuned, Verdict
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.scoring import Score, score
from orbisim.diagnosis.split import bounded, split
from orbisim.diagnosis.suspicious import refuse
from orbisim.effects import find
from orbisim.errors import InputError
from orbisim.recording import Recording
from orbisim.recording.joints import joints
from orbisim.scene import Scene, load_scene

Source = Recording | str | Path

__all__ = ["diagnose"]


def diagnose(
    scene: str | Path | Scene,
    recordings: Source | Sequence[Source],
    held_out: Source | Sequence[Source] | None = None,
    *,
    window: float = 0.5,
    backend: str | Backend = "mujoco",
    settings: Settings | None = None,
    out: str | Path | None = None,
    progress: bool = True,
) -> Diagnosis:
    """Finds the residual, traces it to effects, adds them, and reports the error before and after.

    Args:
      scene: a path or task name, or a scene: the system as declared.
      recordings: measurements to learn from.
      held_out: measurements that no choice and no fit may see; kept back from `recordings` if None.
      window: duration of the windows of free-running simulation, s.
      backend: what the error of the declared scene is computed with; the search simulates with C
        MuJoCo.
      settings: of the search.
      out: folder for report.json, report.html and augmented/scene.xml.
      progress: whether to show what is going on on standard error.

    Raises:
      RecordingError: a recording cannot be read, does not fit the scene, or is clearly wrong.
      SceneError: the scene cannot be read or edited.
      InputError: the recordings are too short, or an option is out of range.
    """
    if not window > 0:
        raise InputError(f"window is a duration in s, greater than 0; got {window}")
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    named = loaded.source if isinstance(scene, Scene) else str(scene)
    loaded.spec  # noqa: B018 (raises if the scene cannot be edited)
    notes: list[str] = []
    fit, held = _sets(recordings, held_out)
    for one in (*fit, *held):
        notes += refuse(one, loaded)
    settings = settings or Settings()
    with _Telling(progress) as say:
        say("reading the recordings")
        samples = prepare_all(bounded(fit, notes), loaded)
        bench = make_bench(loaded, samples, window)
        found = attribute(bench, settings, say)
        say("free-running error on held-out data")
        result = _result(loaded, named, found, settings, fit, held, window, backend, notes)
        if out is not None:
            say("writing the report")
            result.save(out)
    return result


def _sets(recordings: Any, held_out: Any) -> tuple[list[Recording], list[Recording]]:
    every = _loaded(recordings)
    if not every:
        raise InputError("diagnose needs at least one recording")
    if held_out is None:
        return split(every)
    held = _loaded(held_out)
    if not held:
        raise InputError("held_out is empty; leave it out to have some data kept back")
    return every, held


def _loaded(recordings: Any) -> list[Recording]:
    every = [recordings] if isinstance(recordings, (Recording, str, Path)) else list(recordings)
    return [one if isinstance(one, Recording) else Recording.load(one) for one in every]


def _result(
    scene: Scene,
    named: str,
    found: Attribution,
    settings: Settings,
    fit: list[Recording],
    held: list[Recording],
    window: float,
    backend: str | Backend,
    notes: list[str],
) -> Diagnosis:
    hypothesis = found.after.hypothesis
    augmented = hypothesis.scene(scene)
    if any(find(e.effect).measurement for e in hypothesis.effects):
        from orbisim.effects import add_effects

        augmented = add_effects(
            augmented, [e for e in hypothesis.effects if find(e.effect).measurement]
        )
    changed = bool(hypothesis.effects or hypothesis.factors)
    before = {"fit": score(scene, fit, window, (), backend)}
    before["held_out"] = score(scene, held, window, (), backend)
    after = dict(before)
    if changed:
        after = {
            "fit": score(augmented, fit, window, hypothesis.effects),
            "held_out": score(augmented, held, window, hypothesis.effects),
        }
    verdict = _verdict(found, settings)
    return Diagnosis(
        scene=scene,
        source=named,
        backend=backend if isinstance(backend, str) else backend.name,
        fit=tuple(fit),
        held_out=tuple(held),
        noise=_noise(found.bench),
        residual=_residual(found, settings),
        verdict=verdict,
        effects=_effects(scene, found, held, window) if changed else (),
        alternatives=_alternatives(found),
        retuned=_retuned(scene, found),
        error=_errors(before, after, found.bench, window),
        augmented_scene=augmented,
        notes=tuple(dict.fromkeys([*notes, *before["fit"].notes, *before["held_out"].notes])),
        attribution=found,
    )


# -- parts ------------------------------------------------------------


def _verdict(found: Attribution, settings: Settings) -> Verdict:
    before, after = found.before, found.after
    hypothesis = after.hypothesis
    if not hypothesis.effects and not hypothesis.factors:
        return "unexplained" if _significant(found, settings) else "no_residual"
    return (
        "explained"
        if after.ratio <= max(_FLOOR, enough(settings, before))
        else ("partly_explained" if hypothesis.effects else "unexplained")
    )


_FLOOR = 1.5
"""Residual over noise up to which what is left counts as noise."""
_FAINT = 1.15
"""Residual over noise up to which a residual that nothing explains is not called significant."""


def _significant(found: Attribution, settings: Settings) -> bool:
    return found.before.ratio > max(_FAINT, enough(settings, found.before))


def _residual(found: Attribution, settings: Settings) -> dict[str, Any]:
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


def _noise(bench: Bench) -> dict[str, float]:
    found: dict[str, float] = {}
    q_noise, v_noise = bench.noise
    for joint in joints(bench.scene.model):
        for kind, levels in (("qpos", q_noise), ("qvel", v_noise)):
            seen = levels[joint.v]
            seen = seen[np.isfinite(seen)]
            if seen.size:
                found[f"{kind}/{joint.label}"] = float(np.sqrt(np.mean(seen**2)))
    return found


def _errors(
    before: dict[str, Score], after: dict[str, Score], bench: Bench, window: float
) -> dict[str, Any]:
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
        "windows": {"fit": before["fit"].windows, "held_out": before["held_out"].windows},
    }


def _effects(
    scene: Scene, found: Attribution, held: list[Recording], window: float
) -> tuple[FoundEffect, ...]:
    hypothesis = found.after.hypothesis
    free = hypothesis.free(scene)
    names = [f"{i}.{name}" for i, name in free] + [str(one) for one, _ in hypothesis.factors]
    intervals = confidence(found.after, names)
    with_all = score(hypothesis.scene(scene), held, window, hypothesis.effects).rms
    result: list[FoundEffect] = []
    for i, effect in enumerate(hypothesis.effects):
        kind = find(effect.effect)
        fewer = hypothesis.without(i)
        without = score(fewer.scene(scene), held, window, fewer.effects).rms
        parameters = {}
        for p in kind.parameters(scene.model, effect.target):
            value = float(effect.values[p.name])
            ci = intervals.get(f"{i}.{p.name}", _propagated(found, i, p.name, intervals))
            grid = kind.resolution(scene.model, p.name) / 2
            low, high = min(ci[0], value - grid), max(ci[1], value + grid)
            parameters[p.name] = Estimate(value, p.unit, (low, high))
        result.append(
            FoundEffect(
                effect.effect,
                effect.target,
                parameters,
                kind.native,
                {
                    "held_out_error_without": without,
                    "held_out_error_with": with_all,
                    "delta_bic": found.evidence[i][0] if i < len(found.evidence) else float("nan"),
                },
                dict(effect.options),
            )
        )
    return tuple(result)


def _propagated(
    found: Attribution, number: int, name: str, intervals: dict[str, tuple[float, float]]
) -> tuple[float, float]:
    """The interval of a parameter that follows from the free ones, to first order."""
    scene, hypothesis = found.bench.scene, found.after.hypothesis
    value = float(hypothesis.effects[number].values[name])
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
    half = float(np.sqrt(variance))
    return value - half, value + half


def _retuned(scene: Scene, found: Attribution) -> tuple[Retuned, ...]:
    hypothesis = found.after.hypothesis
    first = len(hypothesis.free(scene))
    spread = np.sqrt(np.maximum(np.diag(found.after.fit.covariance), 0.0))
    result = []
    for f, (one, factor) in enumerate(hypothesis.factors):
        half = 1.96 * float(spread[first + f])
        if abs(factor - 1) > max(half, 2e-3):
            result.append(Retuned(str(one), factor, (factor - half, factor + half)))
    return tuple(result)


def _alternatives(found: Attribution) -> tuple[Alternative, ...]:
    """Rivals of the search, and effects that are known to look like the ones found."""
    chosen = found.after.hypothesis.effects
    taken = {(e.effect, e.target) for e in chosen}
    best: dict[tuple[str, str], Alternative] = {}
    for rival in sorted(found.rivals, key=lambda r: r.delta_bic):
        key = (rival.instance.effect, rival.instance.target)
        if key in taken or key in best:
            continue
        tips = [t for e in chosen if (t := advice(e.effect, key[0])) is not None]
        close = rival.delta_bic < 20
        text = (
            "this data hardly tells it apart from what was found"
            if close
            else f"leaves {rival.ratio:.3g} times the noise in round {rival.round}"
        )
        if tips:
            text += f"; to tell them apart, {tips[0]}"
        best[key] = Alternative(*key, rival.delta_bic, text)
    result = list(best.values())[:8]
    for effect, problem in found.rejected:
        result.append(Alternative(effect.effect, effect.target, None, f"not believed: {problem}"))
    for e in chosen:
        for other, text in standing(e.effect)[:2]:
            if not any(a.effect == other for a in result) and other not in {t[0] for t in taken}:
                result.append(Alternative(other, "", None, f"known to look alike; {text}"))
    return tuple(result)


class _Telling:
    """Says what is going on, on standard error, if that is a terminal."""

    def __init__(self, wanted: bool) -> None:
        from orbisim.progress import status

        self._status = status("diagnosing") if wanted else None

    def __enter__(self) -> Any:
        if self._status is None:
            return lambda text: None
        return self._status.__enter__()

    def __exit__(self, *error: Any) -> None:
        if self._status is not None:
            self._status.__exit__(*error)
