"""The search: from the scene as declared to the explanation that predicts best.

A state is an explanation (`Judged`): effects with their values, retuned declared parameters,
fitted starts. A move adds an effect (or several at once), removes one, exchanges one, merges two or
retunes declared parameters. One number decides each: what the later explanation is surely worth
more (`orbisim.diagnosis.worth`). The search ends where no move is, or where the time is up.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from orbisim.diagnosis.context import Context, Progress, begun
from orbisim.diagnosis.glances import generalizations
from orbisim.diagnosis.proposals import additions, begin, exchanges, laws, merged, pairs
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.suspects import Screening
from orbisim.diagnosis.together import propose
from orbisim.diagnosis.worth import gains, retuning_costs, worth
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.evidence import NEAR, Gain
from orbisim.host.deadline import NEVER, Deadline, TimeIsUpError
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, Judged, is_structural


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
      declared: the declared scene, fitted. best: the best explanation.
      screening: of the declared scene; None if nothing had to be explained.
      tried: explanations of all rounds. law: a law without a name that is the better explanation;
        empty if none is. late: whether the search ended because its time was up.
    """

    context: Context
    declared: Judged
    best: Judged
    screening: Screening | None = None
    tried: tuple[Tried, ...] = ()
    law: str = ""
    late: bool = False


def enough(settings: Settings, judged: Judged) -> float:
    """Residual over noise below which there is nothing to explain, given how much data there is."""
    return settings.enough + 3.0 / np.sqrt(2.0 * max(judged.fit.count, 1))


def quiet(settings: Settings, declared: Judged) -> bool:
    """Whether there is nothing to explain: the declared scene predicts all windows to within noise.

    Where bodies touch, an effect may show in a few windows only, which `Judged.ratio` leaves out.
    """
    return max(declared.ratio, declared.pooled) <= enough(settings, declared)


def search(bench: Bench, settings: Settings, say: Progress = lambda _: None) -> Found:
    """Searches until no move is surely worth it, or the bench's deadline has passed.

    Raises:
      FloatingPointError: the declared scene cannot be simulated along the recordings.
    """
    context = begun(bench, settings, say)
    say("fitting the declared scene")
    late = False
    try:
        declared = context.judge.judge(Hypothesis())
    except TimeIsUpError:  # as it is, then: there must be an answer
        late = True
        unlimited = begun(dataclasses.replace(bench, deadline=NEVER), settings, say)
        declared = unlimited.judge.judge(Hypothesis(), 1)
    if declared is None:
        raise FloatingPointError("the scene cannot be simulated along the recordings")
    found = Found(context, declared, declared, late=late)
    if late or quiet(settings, declared):
        return found
    try:
        found = dataclasses.replace(found, context=context.with_tunables())
        say("screening effects")
        found = dataclasses.replace(found, screening=found.context.screen(declared))
        for number in itertools.count(1):
            later = _round(found, number)
            if later.late:
                return later
            settled, found = later.best is found.best, later
            if settled:
                return named(found)
    except TimeIsUpError:
        return dataclasses.replace(found, late=True)
    return found


def _round(found: Found, number: int) -> Found:
    """One move more, and what it makes superfluous gone; the same if none is surely worth it."""
    context, current = found.context, found.best
    context.say(f"round {number}: {current.ratio:.3g} times the noise")
    if done(context, current) or len(current.hypothesis.effects) >= context.settings.most_effects:
        return found
    best, tried, late = _best_move(found, number)
    found = dataclasses.replace(found, tried=(*found.tried, *tried))
    if best is None:
        if late:
            raise TimeIsUpError
        return found
    found = dataclasses.replace(found, best=best)
    try:
        context, best = _renewed(context, best)
        return _simplified(dataclasses.replace(found, context=context, best=best), number)
    except TimeIsUpError:
        return dataclasses.replace(found, late=True)


def done(context: Context, judged: Judged) -> bool:
    """Whether nothing is left to explain."""
    return judged.ratio <= enough(context.settings, judged)


def _renewed(context: Context, judged: Judged) -> tuple[Context, Judged]:
    """The same explanation, with noise and derivatives along its own scene."""
    context = context.along(judged)
    judge = context.judge
    again = judge.judge(judged.hypothesis, begin=judge.begin(judged))
    if not context.bench.contacts:
        cold = judge.judge(judged.hypothesis)
        if cold is not None and (again is None or cold.loss < again.loss):
            again = cold
    for _ in range(_FURTHER if context.bench.contacts else 0):  # steps through impacts are short
        if again is None:
            break
        further = judge.judge(again.hypothesis, begin=judge.begin(again))
        if further is None or worth(context.bench, again, further).total < _EVEN:
            break
        again = further
    return (context, again) if again is not None else (context, judged)


_FURTHER = 4
"""Fits more of what was taken, each from where the last one ended."""
_EVEN = 0.5
"""Log odds within which two explanations are equally good."""


# -- the moves of a round ----------------------------------------------------------------------


def _best_move(found: Found, number: int) -> tuple[Judged | None, list[Tried], bool]:
    """The explanation that is worth most, if it surely is better; all that were tried; and whether
    the time was up. Kinds of moves are tried in turns until one reaches the noise, or a share of
    the time is over and one is sure: the next round sees more from there."""
    context, current = found.context, found.best
    fitted: list[Judged] = []
    best: Judged | None = None
    late = False
    until = Deadline.after(_OF_TIME * context.deadline.left)
    for kind in (_added, _retuned, _two, _together):
        try:
            for judged in kind(found, number, fitted):
                fitted.append(judged)
                if until.passed and _winner(context, current, fitted) is not None:
                    break
        except TimeIsUpError:
            late = True
        best = _winner(context, current, fitted)
        if late or (best is not None and (until.passed or _enough_for_now(context, current, best))):
            break
    return best, _told(context, current, fitted, best, number), late


def _enough_for_now(context: Context, current: Judged, best: Judged) -> bool:
    """Whether nothing is left, or so much less that what else is missing will be seen better from
    there: of two effects, the first may make the second one plain."""
    return done(context, best) or best.loss - _AT_NOISE < _MUCH * (current.loss - _AT_NOISE)


_OF_TIME = 0.2
"""Share of the time left that a round may take to look for more than one sure move."""
_AT_NOISE = float(np.log(2.0))
_MUCH = 0.5
"""Share of the loss above the noise that a move may leave to be made without looking at others."""


def _winner(context: Context, current: Judged, fitted: Sequence[Judged]) -> Judged | None:
    """What is worth most, if it surely is better; of what is equally good, the first in the
    catalogue."""
    if not fitted:
        return None
    known = gains(context.bench, current, fitted)
    sure = [(gain.total, one) for gain, one in zip(known, fitted, strict=True) if gain.sure > 0]
    if not sure:
        return None
    most = max(total for total, _ in sure)
    level = [one for total, one in sure if total > most - _EVEN]
    order = effect_names()

    def place(one: Judged) -> list[int]:
        return sorted(order.index(e.effect) for e in one.hypothesis.effects if e.effect in order)

    return min(level, key=place)


def _told(
    context: Context, current: Judged, fitted: Sequence[Judged], best: Judged | None, number: int
) -> list[Tried]:
    found = []
    for one, gain in zip(fitted, gains(context.bench, current, fitted), strict=True):
        reason = ""
        if best is not None and one is not best:
            reason = f"it explains less than {_names(best)}"
        elif best is None:
            reason = f"it is worth {gain.total:.3g} +- {gain.error:.2g}, which is not sure"
        found.append(Tried(one, number, gain, reason))
    return found


def _names(judged: Judged) -> str:
    effects = [f"{e.effect} at {e.target}" for e in judged.hypothesis.effects]
    more = f" and {len(effects) - 2} more" if len(effects) > 2 else ""
    return " and ".join(effects[:2]) + more or "retuned parameters"


def _fit(
    context: Context, hypothesis: Hypothesis, start: Judged, polish: bool = True
) -> Judged | None:
    """Fitted; of retuned parameters only those that pay."""
    iterations = 4 if context.bench.contacts else 5
    begin = context.judge.begin(start)
    judged = context.judge.judge(hypothesis, iterations, polish, begin)
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


def _added(found: Found, number: int, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """With an effect more."""
    context, current = found.context, found.best
    screening = found.screening
    if number > 1:
        context.say(f"screening what is left ({current.ratio:.3g} times the noise)")
        screening = context.screen(current)
    assert screening is not None
    contacts = context.bench.contacts
    first = [one.last for one in found.tried if one.round == 1 and one.last is not None][:_FEW]
    own: list[Judged] = []
    for candidate in additions(context, current, screening, first):
        if any(done(context, one) for one in own) and (
            candidate.slow or len(own) >= (2 * _FEW if contacts else _FEW)
        ):
            break
        instance = candidate.instance
        context.say(f"round {number}: fitting {instance.effect} at {instance.target}")
        start = begin(context, current, candidate)
        judged = _fit(context, start, current, polish=not contacts)
        if judged is not None:
            own.append(judged)
            yield judged
    yield from _generalized(context, current, own)
    for judged in _best(context, current, own):
        closer = context.judge.closer(judged)
        if closer is not judged:
            yield closer


def _best(context: Context, current: Judged, fitted: Sequence[Judged]) -> list[Judged]:
    """The few with an effect that are worth most."""
    fitted = [one for one in fitted if one.hypothesis.effects]
    if not fitted:
        return []
    known = gains(context.bench, current, fitted)
    order = sorted(range(len(fitted)), key=lambda i: -known[i].total)
    return [fitted[i] for i in order[:_FEW]]


def _generalized(context: Context, current: Judged, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """What is more general than one of the best, fitted from there: a fit begun at a poor place may
    end at one."""
    for special in _best(context, current, fitted):
        own = special.hypothesis.effects[-1]
        less = special.hypothesis.without(len(special.hypothesis.effects) - 1)
        starts: dict[str, list[Hypothesis]] = {}
        for one in generalizations(context, own):
            if one.effect != own.effect and context.allowed(one):
                starts.setdefault(one.effect, []).append(less.plus(one))
        for same in starts.values():
            begin = context.judge.begin(special)
            left = [context.judge.glance(one, begin) for one in same]
            judged = _fit(context, same[int(np.argmin(left))], special)
            if judged is not None:
                yield judged


def _retuned(found: Found, number: int, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """With declared parameters retuned, alone and with the best additions."""
    context, current = found.context, found.best
    if not context.tunables or current.hypothesis.factors:
        return
    context.say("retuning declared parameters")
    tuned = _fit(context, current.hypothesis.tuned(context.tunables), current)
    if tuned is None:
        return
    yield tuned
    context.say("effects with declared parameters retuned")
    near = [one.hypothesis for one in _best(context, current, fitted)]
    if number == 1 and found.screening is not None:
        suspects = found.screening.tuned[: context.settings.shortlist]
        near += [current.hypothesis.plus(one.instance) for one in suspects]
    seen: set[tuple[str, str]] = set()
    for hypothesis in near:
        last = hypothesis.effects[-1]
        if (last.effect, last.target) in seen:
            continue
        seen.add((last.effect, last.target))
        judged = _fit(context, hypothesis.tuned(context.tunables), tuned)
        if judged is not None:
            yield judged


def _two(found: Found, number: int, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """Two effects at once."""
    context, current = found.context, found.best
    if number > 1 or found.screening is None:
        return
    own: list[Judged] = []
    for hypothesis in pairs(context, found.screening):
        context.say(f"fitting {' and '.join(e.effect for e in hypothesis.effects)}")
        judged = _fit(context, hypothesis, current)
        if judged is not None:
            own.append(judged)
            yield judged
            if sum(done(context, one) for one in own) > 1:
                break
    for judged in _best(context, current, own):
        closer = context.judge.closer(judged)
        if closer is not judged:
            yield closer


def _together(found: Found, number: int, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """Many at once: on a real machine each looks wrong as long as the others are missing."""
    context = found.context
    if number > 1 or context.bench.contacts:
        return
    context.say("several effects at once")
    bench, settings = context.bench, context.settings
    effects = propose(bench, context.intervals, settings.effects, settings.most_effects)
    if len(effects) < 2:
        return
    judge = Judge(bench, context.intervals, (), None, settings.windows, heavy=True)
    judged = judge.judge(Hypothesis(effects), _ITERATIONS)
    if judged is not None:
        yield judged


# -- simpler, or another in the place of one ---------------------------------------------------


def _simplified(found: Found, number: int) -> Found:
    """Without effects that are not surely worth it beside the others, with others in their places
    where these are better, and one in the place of two."""
    for change in (_removed, _exchanged, _united, _removed):
        found = change(found, number)
    return found


def _removed(found: Found, number: int) -> Found:
    context = found.context

    def refit(less: Hypothesis, now: Judged) -> Judged | None:
        return _fit(context, less, now)

    return dataclasses.replace(found, best=only_sure(context, found.best, refit).judged)


class Sure(NamedTuple):
    """An explanation without needless effects, the worth of each beside the others, and what went,
    with the reason."""

    judged: Judged
    gains: tuple[Gain, ...] = ()
    rejected: tuple[tuple[EffectInstance, str], ...] = ()


def only_sure(
    context: Context,
    judged: Judged,
    refit: Callable[[Hypothesis, Judged], Judged | None],
    bare: Judged | None = None,
) -> Sure:
    """With those effects only that are surely worth it beside the others; what is least so goes
    first.

    Args:
      refit: fits an explanation with an effect less, from where the one with it is.
      bare: without any effect, if it may come to that; else one effect stays.
    """
    rejected: list[tuple[EffectInstance, str]] = []
    while len(judged.hypothesis.effects) > (1 if bare is None else 0):
        doubt: list[tuple[Gain, EffectInstance, Judged]] = []
        for index, effect in enumerate(judged.hypothesis.effects):
            less = judged.hypothesis.without(index)
            nothing = bare is not None and not less.effects and not less.factors
            fewer = bare if nothing else refit(less, judged) or bare
            if fewer is not None:
                doubt.append((worth(context.bench, fewer, judged), effect, fewer))
        if not doubt:
            break
        gain, effect, simpler = min(doubt, key=lambda one: one[0].sure)
        if gain.sure > 0:
            return Sure(judged, tuple(one[0] for one in doubt), tuple(rejected))
        reason = (
            f"beside the others it is worth {gain.total:.3g} +- {gain.error:.2g} in the logarithm "
            "of the odds, which is not sure"
        )
        rejected.append((effect, reason))
        judged = simpler
    return Sure(judged, (), tuple(rejected))


def _exchanged(found: Found, number: int) -> Found:
    context, best = found.context, found.best
    places = [(e.effect, e.target) for e in best.hypothesis.effects]
    for place in places:
        now = [(e.effect, e.target) for e in best.hypothesis.effects]
        if place not in now:
            continue
        index = now.index(place)
        fewer: Judged | None = dataclasses.replace(best, hypothesis=Hypothesis())
        if len(now) > 1 or best.hypothesis.factors:
            fewer = _fit(context, best.hypothesis.without(index), best)
        if fewer is None:
            continue
        context.say(f"looking for another effect instead of {place[0]} at {place[1]}")
        beside = sorted((t for t in found.tried if t.round == number), key=lambda t: -t.gain.total)
        ranked = [t.last for t in beside if t.last is not None]
        others = _all(context, exchanges(context, best, index, fewer, ranked), best)
        others += list(map(context.judge.closer, _best(context, best, others)))
        better = _winner(context, best, others)
        if better is not None and worth(context.bench, best, better).total > _EVEN:
            gain = worth(context.bench, better, best)
            lost = Tried(best, number, gain, f"it explains less than {_names(better)}")
            found, best = dataclasses.replace(found, tried=(*found.tried, lost)), better
    return dataclasses.replace(found, best=best)


def _united(found: Found, number: int) -> Found:
    context, best = found.context, found.best
    count = len(best.hypothesis.effects)
    if count < 2 or context.bench.contacts or is_structural(best.hypothesis):
        return found
    for one, other in itertools.combinations(range(count), 2):
        context.say("looking for one effect instead of two")
        others = _all(context, merged(context, best, one, other), best)
        better = [one for one in others if worth(context.bench, best, one).total > _EVEN]
        if better:
            return dataclasses.replace(found, best=_best(context, best, better)[0])
    return found


def _all(context: Context, every: Iterable[Hypothesis], start: Judged) -> list[Judged]:
    return [one for h in every if (one := _fit(context, h, start)) is not None]


def named(found: Found) -> Found:
    """With the law without a name that is the better explanation, if there is one. An effect that
    by itself leaves no more than noise keeps its name, though: not it, but what was added to it
    below that, is what a law does as well."""
    context, best = found.context, found.best
    effects = best.hypothesis.effects
    if context.bench.contacts or not effects or (len(effects) < 2 and best.ratio <= NEAR):
        return found
    context.say("laws without a name")
    better = _best(context, best, _all(context, laws(context, best), best))[:1]
    for judged in better:
        gain = worth(context.bench, best, judged)
        if (gain.total if best.ratio <= NEAR else gain.sure) > 0:
            alone = _alone(found)
            if alone is not None:
                return dataclasses.replace(found, best=alone)
            own = judged.hypothesis.effects[-1]
            phrase = f"{find(own.effect).phrase}, at {own.target!r} alone, explains it as well"
            return dataclasses.replace(found, law=phrase)
    return found


def _alone(found: Found) -> Judged | None:
    """The best single effect that was surely worth it and leaves no more than noise."""
    first = [one for one in found.tried if one.round == 1 and one.gain.sure > 0]
    alone = [
        one
        for one in first
        if len(one.judged.hypothesis.effects) == 1
        and not one.judged.hypothesis.factors
        and one.judged.ratio <= NEAR
    ]
    return max(alone, key=lambda one: one.gain.total).judged if alone else None


_FEW = 3
"""How many of those worth most are fitted again along their own scenes."""
_ITERATIONS = 8
"""Of a fit of many effects at once, which begins far off."""
