"""A diagnosis in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from orbisim.diagnosis.found import Retuned, Term, Verdict
from orbisim.effects import find
from orbisim.effects.estimate import FoundEffect


def sentence(
    *,
    verdict: Verdict,
    effects: Sequence[FoundEffect],
    retuned: Sequence[Retuned],
    error: Mapping[str, Any],
    residual: Mapping[str, Any],
    of_sensors: bool,
    cut_short: bool = False,
) -> str:
    """The verdict in one sentence.

    Args:
      verdict, effects, retuned, error, residual: as in `Diagnosis`.
      of_sensors: whether what is wrong are readings of sensors, and the motion is not.
      cut_short: whether the search ended because its time was up.
    """
    unit = error["unit"]
    before, after = error["held_out"]["before"], error["held_out"]["after"]
    what_error = error.get("name", "free-running error")
    floor = f"measurement noise {number(error['noise_floor'])} {unit}"
    if verdict == "no_residual":
        return (
            f"The scene as declared predicts the recordings to within the noise: {what_error} "
            f"on held-out data {number(before)} {unit}, {floor}; no effect is added."
        )
    if verdict == "unexplained" and of_sensors:
        return _unexplained_sensors(error, residual, floor)
    if verdict == "unexplained":
        times = number(residual["ratio_to_noise"])
        return (
            f"The recordings deviate from the scene ({times} times the noise), and "
            f"{_CUT_SHORT if cut_short else _NOTHING}: {what_error} on held-out data "
            f"{number(before)} {unit}, {floor}."
        )
    moving = [e for e in effects if not e.error_unit]
    if effects and not moving and not retuned:
        return _of_sensors(verdict, effects, error, floor)
    what = " and ".join(described(effect) for effect in effects)
    if not what:
        named = ", ".join(f"{t.label} by {100 * (t.factor - 1):+.1f} %" for t in retuned)
        named = named or "several together, none of them clearly"
        what = f"no effect is missing, but declared parameters are off ({named})"
    rest = _of_starts(error, residual) if verdict == "explained" else _REMAINS
    goes = "falls" if after <= before else "rises"
    return (
        f"{what[0].upper()}{what[1:]}; {what_error} on held-out data {goes} from "
        f"{number(before)} {unit} to {number(after)} {unit} ({floor}){rest}."
    )


_NOTHING = "no effect of the catalogue explains it"
_CUT_SHORT = "the search ended before it found what explains it (a longer --patience lets it go on)"
_REMAINS = "; something structured remains"
_FAR = 2.0
"""Times the noise from which on a reader asks why that is called explained."""


def _of_starts(error: Mapping[str, Any], residual: Mapping[str, Any]) -> str:
    """Why an error far above the noise is nothing that the scene lacks.

    Windows start at recorded states, whose noise grows on the way; the verdict looks at windows
    whose starts are estimated.
    """
    left = residual.get("ratio_after")
    if left is None or not error["held_out"]["after"] > _FAR * error["noise_floor"]:
        return ""
    return (
        "; it is above the noise because each free run starts at a recorded state, whose own "
        f"error grows on the way: with estimated starts {number(left)} times the noise is left"
    )


def _unexplained_sensors(error: Mapping[str, Any], residual: Mapping[str, Any], floor: str) -> str:
    """The motion is right, and readings are not."""
    worst = max(residual["sensors"], key=lambda s: s["ratio_to_noise"])
    before = number(error["held_out"]["before"])
    return (
        f"The motion is predicted to within the noise (free-running error {before} "
        f"{error['unit']}, {floor}), but sensor {worst['target']!r} deviates by "
        f"{number(worst['ratio_to_noise'])} times its noise, and neither an offset, a scale nor a "
        "delay explains it."
    )


def _of_sensors(
    verdict: Verdict, effects: Sequence[FoundEffect], error: Mapping[str, Any], floor: str
) -> str:
    """The verdict where only readings of sensors beside the joints are wrong."""
    parts = []
    for effect in effects:
        without, with_it = (effect.evidence[f"held_out_error_{k}"] for k in ("without", "with"))
        parts.append(
            f"{described(effect)}: its error on held-out data falls from {number(without)} to "
            f"{number(with_it)} {effect.error_unit}"
        )
    motion = (
        "the motion is predicted to within the noise"
        if verdict == "explained"
        else "something structured remains"
    )
    before = number(error["held_out"]["before"])
    text = "; ".join(parts)
    return (
        f"{text[0].upper()}{text[1:]}; {motion} (free-running error {before} "
        f"{error['unit']}, {floor})."
    )


def described(effect: FoundEffect) -> str:
    """'the elbow lacks Coulomb friction of 0.35 +- 0.01 N*m'."""
    first = next(iter(effect.parameters.values()))
    low, high = first.ci95
    half = max(first.value - low, high - first.value)
    sure = f" ± {number(half, 2)}" if np.isfinite(half) else ""
    amount = f"{number(first.value)}{sure} {first.unit}".strip()
    amount = amount.removesuffix(" 1")
    phrase = find(effect.effect).phrase
    where = {"world": "the world", "recording": "the recordings' clock"}.get(
        effect.target, f"{effect.target!r}"
    )
    label = next(iter(effect.parameters))
    axis = f" along {effect.options['axis']}" if "axis" in effect.options else ""
    return f"{where} lacks {phrase}{axis} ({label} {amount})"


def together(terms: Sequence[Term], value: float, ci95: tuple[float, float], unit: str) -> str:
    """'mass of a payload at 'upper' or 'fore': only the sum is determined, 2.1 ± 0.1 kg'."""
    places = [f"{t.parameter} of {find(t.effect).phrase} at {t.target!r}" for t in terms]
    factors = [number(abs(t.coefficient), 2) for t in terms]
    signs = [" - " if t.coefficient < 0 else " + " for t in terms]
    if len({(t.effect, t.parameter) for t in terms}) == 1:
        places = [places[0], *(repr(t.target) for t in terms[1:])]
    if set(factors) == {"1"} and set(signs) == {" + "}:
        what = "the sum"
    else:
        parts = [f"{t.parameter} at {t.target!r}" for t in terms]
        parts = [p if f == "1" else f"{f} * {p}" for f, p in zip(factors, parts, strict=True)]
        what = parts[0] + "".join(s + p for s, p in zip(signs[1:], parts[1:], strict=True))
    half = max(ci95[1] - value, value - ci95[0])
    amount = f"{number(value)} ± {number(half, 2)} {unit}".removesuffix(" 1")
    either = f"{', '.join(places[:-1])} or {places[-1]}"
    return f"{either}: only {what} is determined, {amount}"


def number(value: float | None, digits: int = 3) -> str:
    """A number with a few significant digits."""
    return "?" if value is None else f"{value:.{digits}g}"


def interval(low: float, high: float) -> str:
    """Both ends, with digits enough to tell them apart."""
    if not np.isfinite([low, high]).all():
        return "not determined"
    size, width = max(abs(low), abs(high)), high - low
    digits = 3 if not width > 0 else int(np.clip(np.ceil(np.log10(size / width)) + 2, 3, 9))
    return f"{number(low, digits)} to {number(high, digits)}"


def listed(words: Sequence[str]) -> str:
    """'a, b and c'."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
