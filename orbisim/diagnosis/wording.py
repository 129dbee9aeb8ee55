"""A diagnosis in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from orbisim.effects import find

if TYPE_CHECKING:
    from orbisim.diagnosis.result import Diagnosis, FoundEffect


def sentence(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence."""
    error, verdict = diagnosis.error, diagnosis.verdict
    unit = error["unit"]
    before, after = error["held_out"]["before"], error["held_out"]["after"]
    what_error = error.get("name", "free-running error")
    floor = f"measurement noise {number(error['noise_floor'])} {unit}"
    if verdict == "no_residual":
        return (
            f"The scene as declared predicts the recordings to within the noise: {what_error} "
            f"on held-out data {number(before)} {unit}, {floor}; no effect is added."
        )
    if verdict == "unexplained":
        times = number(diagnosis.residual["ratio_to_noise"])
        return (
            f"The recordings deviate from the scene ({times} times the noise), and no effect of "
            f"the catalogue explains it: {what_error} on held-out data {number(before)} "
            f"{unit}, {floor}."
        )
    what = " and ".join(described(effect) for effect in diagnosis.effects)
    if not what:
        named = ", ".join(f"{t.label} by {100 * (t.factor - 1):+.1f} %" for t in diagnosis.retuned)
        what = f"no effect is missing, but declared parameters are off ({named})"
    rest = "" if verdict == "explained" else "; something structured remains"
    return (
        f"{what[0].upper()}{what[1:]}; {what_error} on held-out data falls from "
        f"{number(before)} {unit} to {number(after)} {unit} ({floor}){rest}."
    )


def described(effect: FoundEffect) -> str:
    """'the elbow lacks Coulomb friction of 0.35 +- 0.01 N*m'."""
    first = next(iter(effect.parameters.values()))
    low, high = first.ci95
    half = max(first.value - low, high - first.value, 0.0)
    amount = f"{number(first.value)} ± {number(half, 2)} {first.unit}".strip()
    amount = amount.removesuffix(" 1")
    phrase = find(effect.effect).phrase
    where = {"world": "the world", "recording": "the recordings' clock"}.get(
        effect.target, f"{effect.target!r}"
    )
    label = next(iter(effect.parameters))
    return f"{where} lacks {phrase} ({label} {amount})"


def number(value: float | None, digits: int = 3) -> str:
    """A number with a few significant digits."""
    return "?" if value is None else f"{value:.{digits}g}"


def listed(words: Sequence[str]) -> str:
    """'a, b and c'."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
