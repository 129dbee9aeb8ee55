"""The moves that add: one effect, declared parameters, many effects at once.

Kinds of moves are generators of explanations that are fitted; what they are worth decides which is
made.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.explanations import (
    FEW,
    TO_THE_END,
    Found,
    Tried,
    best_few,
    done,
    fitted_from,
    names_of,
    winner,
)
from orbisim.diagnosis.force_search import attribute_forces, common_forces
from orbisim.diagnosis.glances import generalizations
from orbisim.diagnosis.proposals import additions, begin, events
from orbisim.diagnosis.reselection import fitted_set
from orbisim.diagnosis.suspects import Screening, Suspect
from orbisim.diagnosis.together import propose
from orbisim.diagnosis.worth import gains, worth
from orbisim.effects import EffectInstance, find
from orbisim.errors import InputError
from orbisim.host.deadline import Deadline, TimeIsUpError
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged

Kind = Callable[[Found, int, Sequence[Judged]], Iterator[Judged]]


def best_move(found: Found, number: int) -> tuple[Judged | None, list[Tried], bool]:
    """The explanation that is worth most, if it surely is better; all that were tried; and whether
    the time was up. Kinds of moves are tried in turns until one reaches the noise, or takes most of
    what is left, or a share of the time is over and one is sure: the next round sees more from
    there. In the first round, each kind has such a share: one effect that does little may do much
    beside declared parameters that are a little off, or beside others."""
    context, current = found.context, found.best
    fitted: list[Judged] = []
    best: Judged | None = None
    late = False
    try:
        screening = _screened(found, number)
    except TimeIsUpError:
        return None, [], True
    share = _OF_TIME * context.deadline.left
    until = Deadline.after(share)
    added, happened = (functools.partial(_each, o, screening) for o in (_ranked, _happened))
    windows, *sets = (functools.partial(_together, o) for o in (_by_windows, _usual, _by_forces))
    kinds: list[Kind] = [added, _tuned, windows, happened, _retuned, *sets]
    for kind in kinds:
        if best is not None and _enough_for_now(context, current, best):
            break
        if best is None or number == 1:
            until = Deadline.after(share)
        elif until.passed:
            break
        try:
            for judged in kind(found, number, fitted):
                fitted.append(judged)
                if until.passed and winner(context, current, fitted) is not None:
                    break
        except TimeIsUpError:
            late = True
        best = winner(context, current, fitted)
        if late or (best is not None and done(context, best)):
            break
    return best, _told(context, current, fitted, best, number), late


def _told(
    context: Context, current: Judged, fitted: Sequence[Judged], best: Judged | None, number: int
) -> list[Tried]:
    found = []
    for one, gain in zip(fitted, gains(context.bench, current, fitted), strict=True):
        reason = ""
        if best is not None and one is not best:
            reason = f"it explains less than {names_of(best)}"
        elif best is None:
            reason = f"it is worth {gain.total:.3g} +- {gain.error:.2g}, which is not sure"
        found.append(Tried(one, number, gain, reason))
    return found


def _enough_for_now(context: Context, current: Judged, best: Judged) -> bool:
    """Whether nothing is left, or so much less that what else is missing will be seen better from
    there: of two effects, the first may make the second one plain."""
    return done(context, best) or best.loss - _AT_NOISE < _MUCH * (current.loss - _AT_NOISE)


_OF_TIME = 0.2
"""Share of the time left at its beginning that a round may take to look for more than one sure
move; in the first, each kind of moves."""
_AT_NOISE = float(np.log(2.0))
"""Loss of windows at the noise (`Judged.loss`)."""
_MUCH = 0.5
"""Share of the loss above the noise that a move may leave to be made without looking at others."""


def _screened(found: Found, number: int) -> Screening:
    """What is left, screened."""
    context, current = found.context, found.best
    if number == 1 and found.screening is not None:
        return found.screening
    context.say(f"screening what is left ({current.ratio:.3g} times the noise)")
    return context.screen(current)


def _ranked(screening: Screening, found: Found) -> Iterator[Suspect]:
    """Effects that a regression ranks."""
    first = [one.last for one in found.tried if one.round == 1 and one.last is not None][:FEW]
    return additions(found.context, found.best, screening, first)


def _happened(screening: Screening, found: Found) -> Iterator[Suspect]:
    """Events: no regression ranks these, and each takes as long to try as ten of those above."""
    return events(found.context, found.best, screening.shares)


def _each(
    proposed: Callable[[Screening, Found], Iterator[Suspect]],
    screening: Screening,
    found: Found,
    number: int,
    fitted: Sequence[Judged],
) -> Iterator[Judged]:
    """With an effect more each; the best of them fitted again, and what they lead to."""
    context, current = found.context, found.best
    contacts = context.bench.contacts
    own: list[Judged] = []
    for candidate in proposed(screening, found):
        if len(own) >= (2 * FEW if contacts else FEW) and any(done(context, one) for one in own):
            break
        instance = candidate.instance
        context.say(f"round {number}: fitting {instance.effect} at {instance.target}")
        start = begin(context, current, candidate)
        judged = fitted_from(context, start, current, polish=not contacts)
        if judged is not None:
            own.append(judged)
            yield judged
    yield from _generalized(context, current, own)
    yield from _refined(context, current, own, screening)
    few = []
    for judged in best_few(context, current, own):
        few.append(context.judge.closer(judged))
        if few[-1] is not judged:
            yield few[-1]
    if contacts:
        yield from _from_same_starts(context, current, few)


def _from_same_starts(context: Context, current: Judged, few: Sequence[Judged]) -> Iterator[Judged]:
    """The others of a few, fitted again from where the best of them has windows start: a start that
    was not found is no reason against an effect. Then the best of all to the end, and each of the
    best with every window from wherever any of them has found it a good start."""
    ranked = best_few(context, current, few)
    for other in ranked[1:]:
        begin = context.judge.begin(ranked[0])
        again = context.judge.judge(other.hypothesis, begin=begin, restarts=1)
        if again is not None and again.loss < other.loss:
            ranked.append(again)
            yield again
    for best in best_few(context, current, ranked)[:1]:
        closer = context.judge.closer(best, restarts=TO_THE_END)
        if closer is not best:
            ranked.append(closer)
            yield closer
    least: dict[tuple[tuple[str, str], ...], Judged] = {}
    for one in ranked:
        places = tuple((e.effect, e.target) for e in one.hypothesis.effects)
        if places not in least or one.loss < least[places].loss:
            least[places] = one
    for one in best_few(context, current, list(least.values())):
        same = context.judge.started(one, ranked)
        if same is not one:
            yield same


def _generalized(context: Context, current: Judged, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """What is more general than one of the best, fitted from there: a fit begun at a poor place may
    end at one."""
    for special in best_few(context, current, fitted):
        own = special.hypothesis.effects[-1]
        less = special.hypothesis.without(len(special.hypothesis.effects) - 1)
        there = {(one.effect, one.target) for one in special.hypothesis.effects}
        starts: dict[str, list[Hypothesis]] = {}
        for one in generalizations(context, own):
            if (one.effect, one.target) not in there and context.allowed(one):
                starts.setdefault(one.effect, []).append(less.plus(one))
        for same in starts.values():
            begin = context.judge.begin(special)
            left = [context.judge.glance(one, begin) for one in same]
            judged = fitted_from(context, same[int(np.argmin(left))], special)
            if judged is not None:
                yield judged


def _refined(
    context: Context, current: Judged, fitted: Sequence[Judged], screening: Screening
) -> Iterator[Judged]:
    """What refines one of the best beside it, at once: alone, each may have to be larger than any
    machine has it."""
    for simple in best_few(context, current, fitted):
        own = simple.hypothesis.effects[-1]
        for suspect in screening.suspects:
            one = suspect.instance
            if (find(one.effect).refines, one.target) == (own.effect, own.target):
                judged = fitted_from(context, simple.hypothesis.plus(one), simple)
                if judged is not None:
                    yield judged


def _tuned(found: Found, number: int, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """With declared parameters retuned."""
    context, current = found.context, found.best
    if not context.tunables or current.hypothesis.factors:
        return
    context.say("retuning declared parameters")
    tuned = fitted_from(context, current.hypothesis.tuned(context.tunables), current)
    if tuned is not None and tuned.hypothesis.factors:  # else it is what there is
        yield tuned


def _retuned(found: Found, number: int, fitted: Sequence[Judged]) -> Iterator[Judged]:
    """The best additions with declared parameters retuned."""
    context, current = found.context, found.best
    if not context.tunables or current.hypothesis.factors:
        return
    context.say("effects with declared parameters retuned")
    alone = [o for o in fitted if o.hypothesis.factors and not _more(o, current)]
    tuned = alone[-1] if alone else current
    first = best_few(context, current, [one for one in fitted if _more(one, current) == 1])
    near = [one.hypothesis for one in first]
    if number == 1 and found.screening is not None:
        suspects = found.screening.tuned[: context.settings.shortlist]
        near += [current.hypothesis.plus(one.instance) for one in suspects]
    seen: set[tuple[str, str]] = set()
    for hypothesis in near:
        last = hypothesis.effects[-1]
        if (last.effect, last.target) in seen:
            continue
        seen.add((last.effect, last.target))
        judged = fitted_from(context, hypothesis.tuned(context.tunables), tuned)
        if judged is not None:
            yield judged
        if first and hypothesis is first[0].hypothesis:
            both = (current, tuned), (first[0], judged)
            if all(b is None or worth(context.bench, a, b).total <= 0 for a, b in both):
                return  # worth nothing alone nor beside the best: nor beside the others


def _more(one: Judged, current: Judged) -> int:
    """How many effects more there are."""
    return len(one.hypothesis.effects) - len(current.hypothesis.effects)


def _together(
    proposed: Callable[[Context], tuple[EffectInstance, ...]],
    found: Found,
    number: int,
    fitted: Sequence[Judged],
) -> Iterator[Judged]:
    """Many at once: on a real machine each looks wrong as long as the others are missing. Without
    what is not surely worth it: a dozen cost too much to be compared with one."""
    context = found.context
    if number > 1 or context.bench.rugged:
        return
    context.say("several effects at once")
    try:
        effects = proposed(context)
    except InputError:  # too few samples with accelerations
        return
    if effects:
        yield from fitted_set(context, Hypothesis(effects).in_parts())


def _by_windows(context: Context) -> tuple[EffectInstance, ...]:
    """What windows of free runs say of all effects together."""
    settings = context.settings
    return propose(context.bench, context.intervals, settings.effects, settings.most_effects)


def _usual(context: Context) -> tuple[EffectInstance, ...]:
    """What every machine has at its joints."""
    bench, settings = context.bench, context.settings
    return common_forces(bench.scene, bench.samples, settings.effects, settings.most_effects)


def _by_forces(context: Context) -> tuple[EffectInstance, ...]:
    """What the forces that are missing along the motion say of all effects together."""
    bench, until = context.bench, Deadline.after(_OF_TIME * context.deadline.left)
    found = attribute_forces(bench.scene, bench.samples, context.settings, deadline=until)
    return found.hypothesis.effects[: context.settings.most_effects]
