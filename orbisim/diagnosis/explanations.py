"""Explanations that a search has fitted, and which of some is the best."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.suspects import Screening
from orbisim.diagnosis.worth import gains, retuning_costs, worth
from orbisim.effects import EffectInstance, effect_names
from orbisim.evidence import Gain
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.stepping import Stepping


@dataclasses.dataclass(frozen=True, eq=False)
class Tried:
    """An explanation that a search has fitted.

    Attributes:
      judged: the explanation. round: of the search. gain: over the explanation of that round.
      reason: why it was not taken; empty if it was.
    """

    judged: Judged
    round: int
    gain: Gain
    reason: str = ""

    @property
    def last(self) -> EffectInstance | None:
        """The effect that came last, if there is any."""
        effects = self.judged.hypothesis.effects
        return effects[-1] if effects else None


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """What a search has found.

    Attributes:
      context: data and noise as they were known in the end.
      given: how the scene was stepped when it was given. stepping: how it is in the search, in
        fewer steps where these hardly show.
      declared: the declared scene, fitted, with step and controls as in the end. best: the best
        explanation.
      screening: of the declared scene; None if nothing had to be explained.
      tried: explanations of all rounds. law: a law without a name that is the better explanation;
        empty if none is. late: whether the search ended because its time was up.
    """

    context: Context
    given: Stepping
    stepping: Stepping
    declared: Judged
    best: Judged
    screening: Screening | None = None
    tried: tuple[Tried, ...] = ()
    law: str = ""
    late: bool = False


def enough(settings: Settings, judged: Judged, signals: int = 1) -> float:
    """Residual over noise below which there is nothing to explain, given how much data there is.

    Args:
      signals: how many have their part of the data.
    """
    return settings.enough + 3.0 * np.sqrt(signals / (2.0 * max(judged.fit.count, 1)))


def quiet(settings: Settings, declared: Judged) -> bool:
    """Whether there is nothing to explain: the declared scene predicts all windows, and each signal
    over all of them, to within noise.

    Where bodies touch, an effect may show in a few windows only, which `Judged.ratio` leaves out,
    or along one axis, beside others of which impacts leave little known.
    """
    some = declared.signals
    if some.max(initial=0.0) > enough(settings, declared, len(some)):
        return False
    return max(declared.ratio, declared.pooled) <= enough(settings, declared)


def done(context: Context, judged: Judged) -> bool:
    """Whether nothing is left to explain; without any effect, in no window (see `quiet`)."""
    if not judged.hypothesis.effects and not judged.hypothesis.factors:
        return quiet(context.settings, judged)
    return judged.ratio <= enough(context.settings, judged)


def winner(context: Context, current: Judged, fitted: Sequence[Judged]) -> Judged | None:
    """What is worth most, if it surely is better; of what is equally good, the first in the
    catalogue."""
    if not fitted:
        return None
    known = gains(context.bench, current, fitted)
    sure = [(gain.total, one) for gain, one in zip(known, fitted, strict=True) if gain.sure > 0]
    if not sure:
        return None
    most = max(total for total, _ in sure)
    level = [one for total, one in sure if total > most - EVEN]
    order = effect_names()

    def place(one: Judged) -> list[int]:
        return sorted(order.index(e.effect) for e in one.hypothesis.effects if e.effect in order)

    return min(level, key=place)


def names_of(judged: Judged) -> str:
    """The first two effects of an explanation, and how many more it has."""
    effects = [f"{e.effect} at {e.target}" for e in judged.hypothesis.effects]
    more = f" and {len(effects) - 2} more" if len(effects) > 2 else ""
    return " and ".join(effects[:2]) + more or "retuned parameters"


def fitted_from(
    context: Context, hypothesis: Hypothesis, start: Judged, polish: bool = True
) -> Judged | None:
    """Fitted; of retuned parameters only those that pay. A fit through impacts that begins at a
    poor size may end at one: one that leaves no less than before begins once more with little."""
    iterations = 4 if context.bench.contacts else 5
    begin = context.judge.begin(start)
    judged = context.judge.judge(hypothesis, iterations, polish, begin)
    if context.bench.contacts and not (judged and judged.loss < start.loss):
        little = hypothesis.little(context.bench.scene, start.hypothesis)
        again = None if little is None else context.judge.judge(little, iterations, False, begin)
        if again is not None and not (judged and judged.loss <= again.loss):
            judged = again
    if judged is None or not judged.hypothesis.factors:
        return judged
    return _pruned(context, judged)


def _pruned(context: Context, judged: Judged) -> Judged:
    """Without those retuned parameters that cost more than they bring (by Laplace's approximation:
    half the square of the distance from 1 in standard deviations)."""
    hypothesis = judged.hypothesis
    first = len(hypothesis.free(context.bench.scene))
    deviation = np.sqrt(np.maximum(np.diag(judged.fit.covariance)[first:], 1e-300))
    away = np.array([factor - 1 for _, factor in hypothesis.factors]) / deviation
    costs = retuning_costs(context.bench, judged, float(max(judged.fit.count, 2)))
    pays = away**2 / 2 > costs
    if pays.all():
        return judged
    kept = tuple(one for one, p in zip(hypothesis.factors, pays, strict=True) if p)
    fewer = dataclasses.replace(hypothesis, factors=kept)
    again = context.judge.judge(fewer, 3, begin=context.judge.begin(judged))
    better = again is not None and worth(context.bench, judged, again).total > 0
    return again if again is not None and better else judged


def best_few(context: Context, current: Judged, fitted: Sequence[Judged]) -> list[Judged]:
    """The few with an effect that are worth most; where bodies touch, without those that surely are
    worth nothing: they began where windows start without them, and restarts help either alike."""
    fitted = [one for one in fitted if one.hypothesis.effects]
    known = gains(context.bench, current, fitted)
    order = sorted(range(len(fitted)), key=lambda i: -known[i].total)
    may = [i for i in order if not context.bench.contacts or known[i].total + known[i].error > 0]
    return [fitted[i] for i in may[:FEW]]


EVEN = 0.5
"""Log odds within which two explanations are equally good."""


FEW = 3
"""How many of those worth most are fitted again along their own scenes."""


TO_THE_END = 2
"""Restarts through impacts of the best of a few, beside the one that each of them has, and of what
it is compared with."""
