"""Simpler explanations, others in the place of parts of one, and laws without a name."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.discretization import as_declared, earlier, reasked, settled
from orbisim.diagnosis.explanations import (
    EVEN,
    FEW,
    Found,
    Tried,
    best_few,
    fitted_from,
    names_of,
    winner,
)
from orbisim.diagnosis.glances import shortlist
from orbisim.diagnosis.proposals import begin, exchanges, laws
from orbisim.diagnosis.worth import apart, vague, worth
from orbisim.effects import EffectInstance, find
from orbisim.effects.unnamed import POWERS
from orbisim.evidence import NEAR, Gain
from orbisim.host.deadline import TimeIsUpError
from orbisim.motion.samples import extent
from orbisim.scene import Scene
from orbisim.shooting.fits import Fit
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged


def simplified(found: Found, number: int) -> Found:
    """Without effects that are not surely worth it beside the others, with others in their places
    where these are better, and timestep and controls as they were where that is worth no less."""
    if not found.best.hypothesis.effects:
        return found
    for change in (_as_declared, _timed, _exchanged, untuned, removed):
        try:
            found = change(found, number)
        except TimeIsUpError:
            return dataclasses.replace(found, late=True)
    return found


def _as_declared(found: Found, number: int) -> Found:
    other = as_declared(found.context, found.best, found.stepping)
    return found if other is None else in_form(found, other)


def _timed(found: Found, number: int) -> Found:
    """With controls that lead or follow their samples in the place of effects that change when
    things are seen or done: all sensors late alike are commands that act after they are logged."""
    if not any(find(one.effect).timing for one in found.best.hypothesis.effects):
        return found
    found.context.say("other times of commands")
    other = earlier(found.context, found.best)
    return found if other is None else in_form(found, other)


def in_form(found: Found, other: tuple[Context, Judged]) -> Found:
    """With another timestep, or controls that change at other times."""
    context, best = other
    bare = not (best.hypothesis.effects or best.hypothesis.factors)
    found = dataclasses.replace(found, context=context, best=best)
    found = dataclasses.replace(found, declared=best) if bare else found
    try:
        context, best = reasked(context, best)
        again = None if bare or context is other[0] else context.judge.judge(Hypothesis())
        declared = best if bare else again or found.declared
        found = dataclasses.replace(found, context=context, best=best, declared=declared)
        return dataclasses.replace(found, screening=context.screen(best)) if bare else found
    except TimeIsUpError:
        return dataclasses.replace(found, late=True)


def removed(found: Found, number: int) -> Found:
    """Without effects that are not surely worth it beside the others, as far as there is time."""
    context, refit = found.context, functools.partial(fitted_from, found.context)
    best, late = found.best, found.late
    try:
        for sure in pruned(context, best, refit):
            best = sure.judged
    except TimeIsUpError:
        late = True
    return dataclasses.replace(found, best=best, late=late)


def not_vague(found: Found) -> Found:
    """Without effects that cannot be told from nothing, and fitted again; with all where that is
    worth less."""
    context, best = found.context, found.best
    fewer = told(context, best)
    again = None if fewer is best else fitted_from(context, fewer.hypothesis, best)
    if again is None or not worth(context.bench, best, again).total > 0:
        return found
    return dataclasses.replace(found, best=again)


class Sure(NamedTuple):
    """An explanation without needless effects, the worth of each beside the others, and what went,
    with the reason."""

    judged: Judged
    gains: tuple[Gain, ...] = ()
    rejected: tuple[tuple[EffectInstance, str], ...] = ()


Refit = Callable[[Hypothesis, Judged], Judged | None]
"""Fits an explanation with less, from where the one with it is."""


def plain(context: Context, judged: Judged, refit: Refit) -> Judged:
    """The best of nested explanations: effects go, those with numbers that no machine has first,
    then the least apart from nothing beside the others, in linear approximation, as to fit each of
    a dozen without takes long. With one, two, four, ... effects, and with all that are possible,
    each is fitted, until more of them are worth no more and even all leave no less. What another
    refines stays as long as that does."""
    scene, hypothesis = context.bench.scene, judged.hypothesis
    fit, path = judged.fit, list[Hypothesis]()
    full = most = len(hypothesis.effects)
    while len(hypothesis.effects) > 1:
        impossible = _impossible(context, hypothesis)
        least = impossible[:1] or _least(scene, hypothesis, fit)
        if not least:
            break
        fit, hypothesis = _dropped(scene, fit, hypothesis, least[0])
        path.append(hypothesis)
        most -= bool(impossible) and len(path) == full - most + 1
    some = {len(hypothesis.effects) * 2**k for k in range(len(path))} | {most}
    best: Judged | None = None
    for less in reversed(path):
        one = refit(less, judged) if len(less.effects) in some else None
        if one is None:
            continue
        if best is None or worth(context.bench, best, one).total > 0:
            best = one
        elif not judged.loss < best.loss:
            break
    if best is None or not worth(context.bench, judged, best).total > 0:
        return judged
    return best


def _impossible(context: Context, hypothesis: Hypothesis) -> list[int]:
    """Numbers of the effects with numbers that no machine has, the last first."""
    model, known = context.bench.scene.model, extent(context.bench.samples)
    effects = reversed(list(enumerate(hypothesis.effects)))
    return [n for n, one in effects if find(one.effect).log_prior(model, one, known) == -np.inf]


def _least(scene: Scene, hypothesis: Hypothesis, fit: Fit) -> list[int]:
    """Number of the effect that is the least apart from nothing; none where no derivative says
    anything of any that may go."""
    refined, every = _refined(hypothesis), range(len(hypothesis.effects))
    known = {n: apart(scene, hypothesis, fit, n) for n in every if n not in refined}
    return [n for n in sorted(known, key=lambda n: known[n])[:1] if np.isfinite(known[n])]


def _refined(hypothesis: Hypothesis) -> set[int]:
    """Numbers of the effects that another one refines."""
    places = {(find(one.effect).refines, one.target) for one in hypothesis.effects}
    return {n for n, e in enumerate(hypothesis.effects) if (e.effect, e.target) in places}


def told(context: Context, judged: Judged) -> Judged:
    """Without effects that cannot be told from nothing, in linear approximation: the numbers of the
    others move as the covariance says, what is left stays. What another refines goes last."""
    scene = context.bench.scene
    while numbers := set(vague(scene, judged)) - _refined(judged.hypothesis):
        fit, hypothesis = _dropped(scene, judged.fit, judged.hypothesis, max(numbers))
        judged = dataclasses.replace(judged, fit=fit, hypothesis=hypothesis)
    return judged


def _dropped(scene: Scene, fit: Fit, hypothesis: Hypothesis, number: int) -> tuple[Fit, Hypothesis]:
    """Without an effect, the numbers of the others as a fit's covariance says they then are."""
    own, neutral = hypothesis.sizes(scene, number)
    every = [k for k, (i, _) in enumerate(hypothesis.free(scene)) if i == number]
    fit, hypothesis = fit.held(own, neutral, every), hypothesis.without(number)
    bounds = hypothesis.unknowns(scene)
    values = np.clip(fit.values, [one.low for one in bounds], [one.high for one in bounds])
    return fit, hypothesis.at(scene, values)


def only_sure(context: Context, judged: Judged, refit: Refit, bare: Judged | None = None) -> Sure:
    """The last of `pruned`."""
    return list(pruned(context, judged, refit, bare))[-1]


def pruned(
    context: Context, judged: Judged, refit: Refit, bare: Judged | None = None
) -> Iterator[Sure]:
    """With fewer and fewer effects, in the end with those only that are surely worth it beside the
    others; what is least so goes first. What the best of nested explanations (see `plain`) does not
    have goes before. Of the others, those that are the least apart from nothing are fitted without
    first: of a dozen, most are plainly there.

    Args:
      bare: without any effect, if it may come to that; else one effect stays.
    """
    before = judged.hypothesis.effects
    judged = plain(context, judged, refit)
    there = {(one.effect, one.target) for one in judged.hypothesis.effects}
    rejected = [(one, _NO_BETTER) for one in before if (one.effect, one.target) not in there]
    yield Sure(judged, (), tuple(rejected))
    while len(judged.hypothesis.effects) > (1 if bare is None else 0):
        doubt: dict[int, tuple[Gain, Judged]] = {}
        for part in _least_apart(context, judged):
            for index in part:
                less = judged.hypothesis.without(index)
                nothing = bare is not None and not less.effects and not less.factors
                fewer = bare if nothing else refit(less, judged) or bare
                if fewer is not None:
                    doubt[index] = worth(context.bench, fewer, judged), fewer
            if any(gain.sure <= 0 for gain, _ in doubt.values()):
                break
        if not doubt:
            break
        least = min(doubt, key=lambda index: doubt[index][0].sure)
        gain, simpler = doubt[least]
        if gain.sure > 0:
            every = tuple(doubt[index][0] for index in sorted(doubt))
            yield Sure(judged, every, tuple(rejected))
            break
        effect = judged.hypothesis.effects[least]
        reason = (
            f"beside the others it is worth {gain.total:.3g} +- {gain.error:.2g} in the logarithm "
            "of the odds, which is not sure"
        )
        rejected.append((effect, reason))
        judged = simpler
        yield Sure(judged, (), tuple(rejected))


_NO_BETTER = "an explanation without it, and without what is less sure than it, is worth more"


def _least_apart(context: Context, judged: Judged) -> list[list[int]]:
    """Numbers of the effects of which no derivative says anything, and of the few that are the
    least apart from nothing; and of the others."""
    scene, hypothesis = context.bench.scene, judged.hypothesis
    known = [apart(scene, hypothesis, judged.fit, n) for n in range(len(hypothesis.effects))]
    order = sorted((n for n, a in enumerate(known) if np.isfinite(a)), key=lambda n: known[n])
    unknown = [n for n, a in enumerate(known) if not np.isfinite(a)]
    return [[*unknown, *order[:FEW]], order[FEW:]]


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
            fewer = fitted_from(context, best.hypothesis.without(index), best)
        if fewer is None:
            continue
        # what steps do, or when commands act, may have been named beside other effects
        form = settled(context, fewer, found.stepping) if len(now) > 1 else None
        if form is not None and worth(context.bench, best, form[1]).total > EVEN:
            found = in_form(found, form)
            context, best = found.context, found.best
            continue
        context.say(f"looking for another effect instead of {place[0]} at {place[1]}")
        ranked = [t.last for t in sorted(found.tried, key=lambda t: -t.gain.total) if t.last]
        others = _all(context, exchanges(context, best, index, fewer, ranked), best)
        others += list(map(context.judge.closer, best_few(context, best, others)))
        if context.bench.contacts:
            known = [best, *others]
            others += [context.judge.started(o, known) for o in best_few(context, best, others)]
        better = winner(context, best, others)
        if better is not None and worth(context.bench, best, better).total > EVEN:
            gain = worth(context.bench, better, best)
            lost = Tried(best, number, gain, f"it explains less than {names_of(better)}")
            found, best = dataclasses.replace(found, tried=(*found.tried, lost)), better
    return dataclasses.replace(found, best=best)


def untuned(found: Found, number: int) -> Found:
    """With declared parameters as they are, and no effect or one in the place of how they were
    retuned, if that is worth more: a dozen factors make up for a part of nearly any effect that is
    missing, whatever it is worth alone."""
    context, best = found.context, found.best
    if not best.hypothesis.factors or not best.hypothesis.effects:
        return found
    context.say("looking for an effect instead of retuned parameters")
    fewer = fitted_from(context, dataclasses.replace(best.hypothesis, factors=()), best)
    if fewer is None:
        return found
    others, late = [fewer], found.late
    try:
        suspects = context.along(fewer).screen(fewer).suspects
        room = FEW if len(fewer.hypothesis.effects) < context.settings.most_effects else 0
        for suspect in shortlist(context, fewer, suspects)[:room]:
            others += _all(context, [begin(context, fewer, suspect)], best)
        others += map(context.judge.closer, best_few(context, best, others[1:]))
    except TimeIsUpError:
        late = True
    return dataclasses.replace(found, best=winner(context, best, others) or best, late=late)


def _all(context: Context, every: Iterable[Hypothesis], start: Judged) -> list[Judged]:
    return [one for h in every if (one := fitted_from(context, h, start)) is not None]


def named(found: Found) -> Found:
    """With the law without a name that is the better explanation, if there is one: it is asked
    where names leave more than noise, or take several effects or as many numbers as a law has.

    An effect of fewer numbers that by itself leaves no more than noise keeps its name, though: not
    it, but what was added to it below that, is what a law does as well.
    """
    context, best = found.context, found.best
    effects = best.hypothesis.effects
    simple = len(effects) < 2 and not _as_a_law(found, best)
    if context.bench.contacts or not effects or (simple and best.ratio <= NEAR):
        return found
    context.say("laws without a name")
    better = best_few(context, best, _all(context, laws(context, best), best))[:1]
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


def _as_a_law(found: Found, judged: Judged) -> bool:
    """Whether an explanation has as many numbers as a law without a name."""
    return len(judged.hypothesis.free(found.context.bench.scene)) >= POWERS


def _alone(found: Found) -> Judged | None:
    """The best single effect that was surely worth it and leaves no more than noise."""
    first = [one for one in found.tried if one.round == 1 and one.gain.sure > 0]
    alone = [
        one
        for one in first
        if len(one.judged.hypothesis.effects) == 1
        and not one.judged.hypothesis.factors
        and one.judged.ratio <= NEAR
        and not _as_a_law(found, one.judged)
    ]
    return max(alone, key=lambda one: one.gain.total).judged if alone else None
