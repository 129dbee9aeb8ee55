"""Which suspects are worth a fit, where regressions say little: one simulation of each tells."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.suspects import Suspect, in_turns
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.host.deadline import Deadline
from orbisim.shooting.hypothesis import clean, sized
from orbisim.shooting.judge import Judged, is_structural


def shortlist(context: Context, current: Judged, suspects: Sequence[Suspect]) -> list[Suspect]:
    """The best to add to a hypothesis. Where there are contacts, one simulation of each of many
    decides, and the first few are fitted from two starts."""
    hypothesis = current.hypothesis
    most = context.settings.shortlist + (_MORE if hypothesis.effects else 0)
    if not context.bench.contacts or is_structural(hypothesis):
        return list(suspects[:most])
    more = usual(context, [one.instance for one in suspects])
    both = in_turns(varied(suspects, 2)[:_GLANCES], more, id)
    glances = _resized(context, current, both)
    ranked = _tried(context, current, glances)
    first = varied(ranked, 1)[:most]
    if hypothesis.factors:  # each fit takes long
        return first
    few = {one.place for one in first[:_FEW]}
    again = [one for one in ranked if one.place in few]
    return [*first, *(one for one in varied(again, 2) if not any(one is f for f in first))]


class _Glance(NamedTuple):
    """left: what an effect would leave. size: how large it is, in units of what was suspected.
    better: how many times that would be better. one: the effect."""

    left: float
    size: float
    better: float
    one: Suspect


def _resized(context: Context, current: Judged, found: Sequence[Suspect]) -> list[_Glance]:
    """Best first, and the best of each effect at a target as large as simulation wants them:
    chained through impacts, regressions overshoot, and what is much too large or too small leaves
    more than the wrong effects do."""

    begin = context.judge.begin(current)

    def glanced(one: Suspect) -> _Glance:
        left, better = context.judge.sized_glance(current.hypothesis.plus(one.instance), begin)
        return _Glance(left, 1.0, better, one)

    made = _in_time(context, found, glanced)
    for _ in range(_RESIZED):
        made.sort(key=lambda glance: glance.left)
        few = {id(one) for one in varied([glance.one for glance in made], 2)[:_FIRST]}
        made.sort(key=lambda glance: id(glance.one) not in few)
        again = _in_time(context, made[: len(few)], lambda one: _again(context, current, one))
        made[: len(again)] = again
    return sorted(made, key=lambda glance: glance.left)


def _again(context: Context, current: Judged, glance: _Glance) -> _Glance:
    """The better of an effect and of the same at the size that would be better."""
    size = glance.size * glance.better
    other = None if 1 / _LIKE < glance.better < _LIKE else glance.one.sized(size)
    if other is None:
        return glance
    begin = context.judge.begin(current)
    left, better = context.judge.sized_glance(current.hypothesis.plus(other), begin)
    if not left < glance.left:
        return glance._replace(better=1.0)
    return _Glance(left, size, better, dataclasses.replace(glance.one, instance=other))


def _tried(context: Context, current: Judged, glances: Sequence[_Glance]) -> list[Suspect]:
    """Ranked by what the first step of a fit leaves, or the glance where that is less."""
    left = {id(glance.one): glance.left for glance in glances}
    hypothesis, begin = current.hypothesis, context.judge.begin(current)
    most = _TRIED if hypothesis.effects else _TRIED_FIRST
    few = varied([glance.one for glance in glances], 2)[:most]

    def least(one: Suspect) -> float:
        return min(left[id(one)], context.judge.tried(hypothesis.plus(one.instance), begin))

    tried = _in_time(context, few, least)
    return [few[i] for i in np.argsort(tried, kind="stable")]


_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def _in_time(
    context: Context, items: Sequence[_Item], work: Callable[[_Item], _Result]
) -> list[_Result]:
    """Works on items, the most promising first, for a share of the time that is left."""
    until, done = Deadline.after(_OF_TIME * context.deadline.left), list[_Result]()
    for item in items:
        if until.passed and len(done) >= _LEAST:
            break
        done.append(work(item))
    return done


_OF_TIME = 0.15
"""Share of the time left that one pass over suspects may take."""
_LEAST = 8
"""Suspects that a pass looks at in any case."""


def usual(context: Context, possible: Sequence[EffectInstance]) -> list[Suspect]:
    """Effects on bodies, at contacts and on all at usual sizes, whatever a regression says:
    payloads and forces in proportion to masses, friction less and more than declared, a tilt to
    either side; and what does the same as a suspect, and more."""
    places = {(e.effect, e.target) for e in possible if find(e.effect).kind in _USUAL}
    scene, made = context.bench.scene, []
    for name, target in sorted(places):
        every = find(name).trials(scene.model, target)
        made += [EffectInstance(name, target, dict(values)) for values in every]
    first = {(e.effect, e.target): e for e in reversed(possible)}
    made += [more for one in first.values() for more in generalizations(context, one)]
    return [Suspect(clean(scene, one), sized=functools.partial(sized, scene, one)) for one in made]


def generalizations(context: Context, special: EffectInstance) -> list[EffectInstance]:
    """What does the same as an effect for now, and more with other numbers."""
    model, only = context.bench.scene.model, context.settings.effects
    return [
        EffectInstance(name, special.target, dict(values))
        for name in effect_names()
        if only is None or name in only
        for values in find(name).generalized(model, special)
        if special.target in find(name).targets(model)
    ]


def varied(found: Sequence[Suspect], most: int) -> list[Suspect]:
    """The first few forms of each effect at a target."""
    count: Counter[tuple[str, str]] = Counter()
    kept = []
    for one in found:
        count[one.place] += 1
        if count[one.place] <= most:
            kept.append(one)
    return kept


_USUAL = ("body", "geom", "world")
"""Kinds of effects of which regressions through impacts say little."""
_GLANCES = 100
"""Forms of suspects that are simulated once."""
_FIRST = 40
"""Two of each effect at a target, the best first, that are simulated again at the size that the run
asked for."""
_RESIZED = 2
"""Times that they are."""
_LIKE = 1.2
"""Factor of size that needs no other run."""
_TRIED = 30
"""Suspects with which the first step of a fit is taken, beside other effects."""
_TRIED_FIRST = 14
"""The same where there is no effect yet: the first one stands out more."""
_MORE = 2
"""Suspects more on a list beside effects that are there: ranks say less then."""
_FEW = 3
"""Suspects that are fitted from two starts."""
