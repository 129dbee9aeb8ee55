"""Whether an effect earns its place, and if not, why not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.refine import Judged, is_structural
from orbisim.diagnosis.retune import REACH, Tunable
from orbisim.diagnosis.settings import Settings

Floats = npt.NDArray[np.float64]


def enough(settings: Settings, judged: Judged) -> float:
    """Residual over noise below which there is nothing to explain, given how much data there is."""
    return settings.enough + 3.0 / np.sqrt(2.0 * max(judged.fit.count, 1))


def strain(hypothesis: Hypothesis) -> list[Tunable]:
    """Declared parameters that are as far off as they may be: those are effects, then."""
    return [one for one, factor in hypothesis.factors if far_off(factor)]


def far_off(factor: float) -> bool:
    """Whether no declared parameter is off by such a factor."""
    return abs(factor - 1) > 0.9 * REACH


def unpaid(settings: Settings, before: Judged, after: Judged) -> str | None:
    """Why the windows that were not fitted do not get better by enough and surely; None if they do.

    Args:
      before, after: the hypothesis without and with the effect, fitted on the same windows.
    """
    gain = before.cost - after.cost
    if settles(before, after) or _clears(settings, before, after):
        return None
    if _unfelt(before, after):
        if gain > _CLEARLY * settings.margin:
            return None  # held-out data have the last word
        return "the windows that it was not fitted to do not feel it"
    one, other = (_capped(before, judged) for judged in (before, after))
    drop = one - other
    excess = max(float(one.mean()) - 1.0, 1e-12)
    mean, error = float(drop.mean()), float(drop.std() / np.sqrt(max(len(drop), 1)))
    if gain > _SURELY * settings.margin and _reaches(settings, before, after, mean > 0):
        return None
    if not mean > 0:
        return "it makes windows that it was not fitted to no better"
    if mean <= settings.gain * max(excess, 0.02):
        return (
            f"on windows that it was not fitted to, it takes away {100 * mean / excess:.2g} % of "
            f"the squared residual; {100 * settings.gain:g} % are needed"
        )
    sure = mean >= settings.certainty * error or mean >= 0.5 * excess
    if not sure and not (gain > _SURELY * settings.margin and _harmless(before, one, other)):
        return (
            f"on windows that it was not fitted to, its gain is {mean / error:.2g} standard errors "
            f"over windows; {settings.certainty:g} are needed"
        )
    if not gain > settings.margin and not _foreseen(before, after):
        return (
            f"the information criterion falls by {gain:.2g}, {settings.margin:g} are needed for "
            "the numbers that it adds"
        )
    return None


def settles(before: Judged, after: Judged) -> bool:
    """Whether a stop accounts for what a few windows alone are bad by, where bodies touch: it makes
    most of that good and no window worse. The criterion does not see it, as a few bad windows may
    be impacts that no start brings about; but what brings about just those is no chance.

    Args:
      before, after: the hypothesis without and with the stop, fitted on the same windows.
    """
    effects = after.hypothesis.effects
    if not before.touching or not effects or effects[-1].effect != "hard_stop":
        return False
    if not few_bad(before) or after.pooled**2 - 1.0 > _LEFT * (before.pooled**2 - 1.0):
        return False
    return _none_worse(before, after)


def _clears(settings: Settings, before: Judged, after: Judged) -> bool:
    """Whether all windows, with none left out, are good with an effect where a few were bad without
    it: one that acts in impacts alone, as adhesion does, the typical window does not feel."""
    if not before.touching or not few_bad(before) or is_structural(after.hypothesis):
        return False
    return after.pooled <= enough(settings, after) and _none_worse(before, after)


def _none_worse(before: Judged, after: Judged) -> bool:
    """Whether no window, fitted or not, gets worse by more than noise and a tenth."""
    windows = ((before.checked, after.checked), (before.fitted, after.fitted))
    return all((other <= 1.1 * np.maximum(one, 1.0)).all() for one, other in windows)


def _foreseen(before: Judged, after: Judged) -> bool:
    """Whether a stop that no window feels that it was fitted to, placed where motion ends, makes
    good most of what is bad in others: they need no criterion."""
    last = after.hypothesis.effects[-1].effect if after.hypothesis.effects else ""
    most = _LEFT * (float(before.checked.mean()) - 1.0)
    stop = last == "hard_stop" and not before.touching
    return stop and most > _BAD and float(after.checked.mean()) - 1.0 <= most


def few_bad(judged: Judged) -> bool:
    """Whether a few windows are bad and the others are not."""
    whole, typical = judged.pooled**2 - 1.0, max(judged.ratio**2 - 1.0, 0.0)
    return whole >= max(_BAD, _FEW_BAD * typical)


def _reaches(settings: Settings, before: Judged, after: Judged, better: bool) -> bool:
    """Whether bodies touch, something was left before, and nothing is left after: what happens in
    a few windows only may be in none of those that were not fitted, or in one.

    Args:
      better: whether windows that were not fitted get better at all; if not, none may be left bad.
    """
    if not before.touching or is_structural(after.hypothesis):
        return False
    most = enough(settings, after)
    return before.pooled > most >= after.ratio and (better or after.pooled <= most)


def _harmless(before: Judged, one: Floats, other: Floats) -> bool:
    """Whether bodies touch and no window gets worse by more than noise and a tenth: where few
    windows feel an effect, their mean is never sure.

    Args:
      one, other: [windows] what is left without and with the effect.
    """
    return before.touching and bool((other <= 1.1 * np.maximum(one, 1.0)).all())


def _unfelt(before: Judged, after: Judged) -> bool:
    """Whether the effect changes nothing in any check window, as its event happens in none. Added
    joints do not count: free at the start of every window, they fit what they like in others."""
    if is_structural(after.hypothesis):
        return False
    change = np.abs(before.checked - after.checked)
    return bool((change <= 1e-3 * np.maximum(before.checked, 1.0)).all())


def _capped(before: Judged, judged: Judged) -> Floats:
    """[windows]: what is left of check windows; where bodies touch, those that are hopeless in any
    case do not hide what becomes of the others."""
    if not before.touching:
        return judged.checked
    cap = _HOPELESS * max(float(np.median(before.checked)), 1.0)
    return np.minimum(judged.checked, cap)


_CLEARLY = 5.0
_SURELY = 10.0
_HOPELESS = 4.0
_BAD = 0.5
"""Mean square beyond the noise, over all windows, above which some are bad."""
_FEW_BAD = 3.0
"""How many times what windows leave with the worst left out, if few are bad."""
_LEFT = 0.35
"""Share of it that may remain."""
