"""What could stand in the place of what was found, and what was tried and not taken."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.found import Alternative, Candidate, Rival
from orbisim.effects.confounds import advice, standing
from orbisim.evidence import Gain, probabilities


def alternatives_of(found: Attribution) -> tuple[Alternative, ...]:
    """Rivals of the search, and effects that are known to look like the ones found."""
    chosen = found.after.hypothesis.effects
    taken = {(e.effect, e.target) for e in chosen}
    own = _own_places(found)
    best: dict[tuple[str, str], Alternative] = {}
    for rival in sorted(found.rivals, key=lambda r: (not r.reason, r.delta_bic)):
        key = (rival.instance.effect, rival.instance.target)
        if key in taken or key in best:
            continue
        tips = [t for e in chosen if (t := advice(e.effect, key[0])) is not None]
        text = f"leaves {rival.ratio:.3g} times the noise in round {rival.round}"
        if abs(rival.delta_bic - own.get(rival.round, np.inf)) < _APART:
            text = "this data hardly tells it apart from what was found"
        else:
            text += f"; {rival.reason or 'dropped later'}"
        if tips:
            text += f"; to tell them apart, {tips[0]}"
        best[key] = Alternative(*key, rival.delta_bic, text, _likely(rival, found.rivals))
    result = list(best.values())[:8]
    doubted = {(e.effect, e.target): problem for e, problem in found.rejected}
    for key, problem in doubted.items():
        if key not in taken:
            result = [a for a in result if (a.effect, a.target) != key]
            result.append(Alternative(*key, None, f"not believed: {problem}"))
    return (*result, *known_alike([e.effect for e in chosen], result))


def known_alike(chosen: Sequence[str], listed: Sequence[Alternative]) -> list[Alternative]:
    """Effects that are known to look like those chosen and are not listed, with what to record."""
    found: list[Alternative] = []
    for name in dict.fromkeys(chosen):
        for other, text in standing(name)[:2]:
            if other not in chosen and not any(a.effect == other for a in (*listed, *found)):
                found.append(Alternative(other, "", None, f"known to look alike; {text}"))
    return found


def _likely(rival: Rival, every: Sequence[Rival]) -> float:
    """Probability of a suspect among those of its round, by the information criterion (Kass and
    Raftery, J. Am. Stat. Assoc. 90, 1995)."""
    own = [one for one in every if one.round == rival.round]
    shares = probabilities(-0.5 * np.array([one.delta_bic for one in own]))
    return round(float(shares[own.index(rival)]), 4)


def suspected(
    suspects: Sequence[tuple[tuple[str, str] | None, tuple[str, str] | None, Gain]],
) -> list[Alternative]:
    """What could stand in the place of an effect, or be added where nothing surely pays.

    Args:
      suspects: each with the effect in whose place it would stand, None for none, and what it is
        worth more.
    """
    found: dict[tuple[str, str], Alternative] = {}
    places: dict[tuple[str, str] | None, list[tuple[tuple[str, str], Gain]]] = {}
    for one, place, gain in suspects:
        if one is not None:
            places.setdefault(place, []).append((one, gain))
    for key, rivals in places.items():
        shares = probabilities(np.array([0.0, *(gain.total for _, gain in rivals)]))[1:]
        for (one, gain), share in zip(rivals, shares, strict=True):
            if share < _UNLIKELY or one in found:
                continue
            text, tip = "may be missing; the gain is not sure", None
            if key is not None:
                text = f"may stand in the place of {key[0]} at {key[1]}"
                tip = advice(key[0], one[0])
            text += f"; to tell them apart, {tip}" if tip else ""
            found[one] = Alternative(*one, -2 * gain.total, text, round(float(share), 4))
    return sorted(found.values(), key=lambda one: -(one.probability or 0.0))[:_MOST_SUSPECTS]


_UNLIKELY = 0.005
"""Probability below which a suspect is not listed."""
_MOST_SUSPECTS = 12
"""What a reader looks through."""


def _own_places(found: Attribution) -> dict[int, float]:
    """For each round that an effect of the final explanation took part in, how far the best such
    effect was behind the round's winner."""
    chosen = {(e.effect, e.target) for e in found.after.hypothesis.effects}
    own: dict[int, float] = {}
    for rival in found.rivals:
        if (rival.instance.effect, rival.instance.target) in chosen:
            own[rival.round] = min(rival.delta_bic, own.get(rival.round, np.inf))
    return own


_APART = 20.0
"""Information criterion within which two effects of a round count as hardly told apart."""


def candidates_of(found: Attribution) -> tuple[Candidate, ...]:
    """Everything that was tried, best of each round first, with why it was not taken."""
    chosen = {(e.effect, e.target) for e in found.after.hypothesis.effects}
    doubted = {(e.effect, e.target): problem for e, problem in found.rejected}
    result = []
    for rival in sorted(found.rivals, key=lambda r: (r.round, r.delta_bic)):
        key = (rival.instance.effect, rival.instance.target)
        reason = "" if key in chosen else rival.reason or doubted.get(key, "dropped later")
        result.append(Candidate(*key, rival.round, rival.ratio, rival.delta_bic, reason))
    seen = {(c.effect, c.target) for c in result} | chosen
    result += [
        Candidate(*key, None, None, None, problem)
        for key, problem in doubted.items()
        if key not in seen
    ]
    return tuple(result)
