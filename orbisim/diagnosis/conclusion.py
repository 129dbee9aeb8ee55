"""The end of a search: the fit on all windows, and what each effect brings."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence

import numpy as np

from orbisim.diagnosis.context import Context, Progress
from orbisim.diagnosis.discretization import as_given
from orbisim.diagnosis.explanations import Found, Tried
from orbisim.diagnosis.found import Rival
from orbisim.diagnosis.search import search
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.simplification import Sure, only_sure, plain, told
from orbisim.diagnosis.suspects import Screening
from orbisim.diagnosis.worth import log_prior, prior, vague, worth
from orbisim.effects import EffectInstance, find
from orbisim.evidence import NEAR, Gain
from orbisim.host.deadline import NEVER, Deadline, TimeIsUpError
from orbisim.motion.samples import Samples
from orbisim.shooting.bench import Bench
from orbisim.shooting.disturbances import Remainder
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.remainder import bare_is_noise, left_of


@dataclasses.dataclass(frozen=True, eq=False)
class Attribution:
    """What the search found.

    Attributes:
      bench: the data, with the noise as it was known in the end.
      before, after: the declared scene and the final hypothesis, fitted on all windows.
      first: screening of the declared scene; None if nothing had to be explained.
      rivals: what was fitted in all rounds.
      evidence: for each effect twice the log odds that it brings beside the others.
      rejected: effects that lowered the residual but were not believed, with the reason.
      cut_short: whether the search ended because its time was up.
      rugged: whether effects on contacts leave more than noise: intervals say less than they seem.
      law: a law without a name that is the better explanation; empty if none is.
      left: what is left in the end, as noise; None if that is not known.
    """

    bench: Bench
    before: Judged
    after: Judged
    first: Screening | None
    rivals: tuple[Rival, ...]
    evidence: tuple[float, ...]
    rejected: tuple[tuple[EffectInstance, str], ...]
    cut_short: bool
    rugged: bool = False
    law: str = ""
    left: Remainder | None = None

    @property
    def samples(self) -> tuple[Samples, ...]:
        """The recordings that were fitted."""
        return self.bench.samples

    @property
    def hypothesis(self) -> Hypothesis:
        """The effects, with fitted values."""
        return self.after.hypothesis


def attribute(
    bench: Bench,
    settings: Settings,
    say: Progress = lambda _: None,
    deadline: Deadline | None = None,
) -> Attribution:
    """Searches for the effects that a scene lacks.

    Args:
      bench: the data; its own deadline is that of the search.
      deadline: of the final fits, after that; none if None.
    """
    found = search(bench, settings, say)
    # a search may have left out steps; what is reported is of those given
    found = dataclasses.replace(found, context=as_given(found.context, found.given))
    try:
        say("final fit")
        return concluded(found, deadline or NEVER)
    except TimeIsUpError:
        return _as_found(found, Deadline((deadline or NEVER).at + _AFTERWARDS * settings.patience))


_AFTERWARDS = 0.05
"""Share of the patience in which needless effects are dropped where final fits had no time."""


def _best_first(found: Found) -> list[Judged]:
    """The explanation that was taken, if it explains anything, and what else was surely worth it at
    first, best first: where nothing of the former is left on all windows, another may hold."""
    best = found.best.hypothesis
    first = [one for one in found.tried if one.round == 1 and one.gain.sure > 0]
    first.sort(key=lambda one: -one.gain.total)
    places = {(e.effect, e.target) for e in best.effects}
    new = [o for o in first if o.last and (o.last.effect, o.last.target) not in places]
    taken = [found.best] if best.effects or best.factors else []
    return [*taken, *(one.judged for one in new[:_RUNNERS_UP])]


_RUNNERS_UP = 2
"""Explanations that are tried where nothing is left of the best on all windows."""


def _open(bench: Bench) -> Bench:
    """Without a deadline, for what only reports."""
    return dataclasses.replace(bench, deadline=NEVER)


def concluded(found: Found, deadline: Deadline) -> Attribution:
    """What a search has found, fitted to all windows and weighed.

    Raises:
      TimeIsUpError: the deadline has passed.
    """
    if found.late or found.stepping != found.given:
        # noise and derivatives may still be along what there was before
        along = found.context.until(deadline).along(found.best)
        found = dataclasses.replace(found, context=along)
    context = found.context.whole(deadline, _MOST_WINDOWS)
    before = _finally(found, context, found.declared, Hypothesis()) or found.declared
    after, gains = before, tuple[Gain, ...]()
    rejected: list[tuple[EffectInstance, str]] = []
    if found.law:
        rejected += [(effect, found.law) for effect in found.best.hypothesis.effects]
    else:
        for one in _best_first(found):
            after = _finally(found, context, one, one.hypothesis.in_parts()) or one
            after = _resized(context, context.judge.fair(after, [before]))
            after, gains, doubted = _sure(context, before, after)
            rejected += doubted
            if after.hypothesis.effects or after.hypothesis.factors:
                break
    bench, left = context.bench, left_of(context.bench, after)
    odds = 0.0 if left is None else log_prior(bench, after, np.isfinite(left.data.y).sum())
    if noise := bare_is_noise(bench, before, after, left, odds):
        rejected += [(effect, _NOISE) for effect in after.hypothesis.effects]
        after, gains, left = before, (), noise
    return Attribution(
        _open(found.context.bench), before, after, found.screening, rivals_of(found.tried),
        tuple(2 * one.total for one in gains), tuple(rejected), found.late,
        bool(_on_contacts(context, after)), found.law, left,
    )  # fmt: skip


def _as_found(found: Found, until: Deadline = NEVER) -> Attribution:
    """What the search had when the time was up, without what cannot be told from nothing."""
    bench, context = found.context.bench, found.context.until(until)

    def refit(less: Hypothesis, now: Judged) -> Judged | None:
        return context.judge.judge(less, 3, begin=context.judge.begin(now))

    best = found.best
    with contextlib.suppress(TimeIsUpError):
        best = next((plain(context, one, refit) for one in _best_first(found)), best)
    best = told(context, best) if best.hypothesis.effects else best
    gain = 2 * worth(bench, found.declared, best).total if best is not found.declared else 0.0
    evidence = tuple(gain for _ in best.hypothesis.effects)
    tried = rivals_of(found.tried)
    before, first = found.declared, found.screening
    return Attribution(_open(bench), before, best, first, tried, evidence, (), True)


def _finally(
    found: Found, context: Context, known: Judged, hypothesis: Hypothesis
) -> Judged | None:
    """A hypothesis fitted on all windows, with what some of them alone did not determine.

    Args:
      known: what has windows' starts close to the hypothesis' own.
    """
    anew = dataclasses.replace(hypothesis, frozen=frozenset())
    fitted = _fitted(found, context, known, anew)
    possible = fitted is not None and prior(context.bench, fitted.hypothesis) > -np.inf
    if possible or not known.hypothesis.frozen:
        return fitted
    # what all windows do not determine either has gone where no machine has it
    kept = _fitted(found, context, known, known.hypothesis)
    return fitted if kept is None else kept


def _fitted(found: Found, context: Context, known: Judged, anew: Hypothesis) -> Judged | None:
    """From nothing and from what was known, whichever is better."""
    judge, cold = context.judge, None
    if not context.bench.contacts:  # there a start from nothing takes long
        cold = judge.judge(anew, 8)
        if cold is not None and cold.ratio <= NEAR:
            return cold
    begin = judge.begin_joined(known, found.context.judge)
    warm = judge.judge(anew, 8, begin=begin)  # from nothing may be no good: a stop
    return min((one for one in (cold, warm) if one), key=lambda one: one.loss, default=None)


def _sure(context: Context, before: Judged, after: Judged) -> Sure:
    """With those effects only that are surely worth it, on all windows, and told from nothing."""
    judge, scene = context.judge, context.bench.scene

    def refit(less: Hypothesis, now: Judged) -> Judged | None:
        fewer = judge.judge(less, 3, begin=judge.begin(now))
        return None if fewer is None else judge.fair(fewer, [now])

    bare = judge.fair(before, [after])
    sure = only_sure(context, after, refit, bare)
    while True:
        wide, again, late = sure.judged, None, tuple[type[TimeIsUpError], ...]()
        if not vague(scene, wide):  # through impacts, to ask how sure numbers are takes long
            half = context.until(Deadline.after(context.deadline.left / 2.0))
            wide, late = half.judge.as_sure(wide), (TimeIsUpError,)
        numbers = vague(scene, wide)
        with contextlib.suppress(*late):  # what is known by then is an answer, if not the last
            less = refit(wide.hypothesis.without(numbers[0]), sure.judged) if numbers else None
            again = None if less is None else only_sure(context, less, refit, bare)
        if again is None:
            sure = sure._replace(judged=wide)
            break
        gone = (wide.hypothesis.effects[numbers[0]], _VAGUE)
        sure = again._replace(rejected=(*sure.rejected, gone, *again.rejected))
    hypothesis = sure.judged.hypothesis
    if hypothesis.effects or not hypothesis.factors:
        return sure
    left, gain = sure.judged.ratio, worth(context.bench, bare, sure.judged)
    return sure._replace(judged=before) if left > NEAR or gain.sure <= 0 else sure


_VAGUE = "its interval includes nothing of it"
_NOISE = "beside noise that lasts it is not surely worth it"


def _on_contacts(context: Context, after: Judged) -> list[int]:
    """Numbers of the effects on contacts, if bodies touch and more than noise is left."""
    if not context.bench.contacts or after.ratio <= NEAR:
        return []
    effects = after.hypothesis.effects
    return [i for i, e in enumerate(effects) if find(e.effect).kind == "geom"]


def _resized(context: Context, after: Judged) -> Judged:
    """The same effects with other numbers of contacts, where more than noise is left: through
    impacts a fit stays where it began. The first parameter of each is simulated once at other
    sizes, and fitted from those that leave least."""
    model = context.bench.scene.model
    for number in _on_contacts(context, after):
        effect = after.hypothesis.effects[number]
        name = find(effect.effect).free_parameters(model, effect.target)[0]
        context.say(f"trying other sizes of {effect.effect} at {effect.target}")
        tried, begin, starts = [after], context.judge.begin(after), list[Hypothesis]()
        for size in _SIZES:
            effects = list(after.hypothesis.effects)
            effects[number] = effect.replace(**{name: size * effect.values[name]})
            starts.append(dataclasses.replace(after.hypothesis, effects=tuple(effects)))
        left = [context.judge.glance(one, begin) for one in starts]
        for index in np.argsort(left, kind="stable")[:_CLOSEST]:
            judged = context.judge.judge(starts[index], 5, polish=False, begin=begin)
            tried += [judged] if judged is not None else []
        after = min(tried, key=lambda one: one.loss)
    return after


def rivals_of(tried: Sequence[Tried]) -> tuple[Rival, ...]:
    """The best that each effect came to in each round, against the best of the round."""
    most: dict[int, float] = {}
    best: dict[tuple[int, str, str], Tried] = {}
    for one in sorted(tried, key=lambda one: -one.gain.total):
        most.setdefault(one.round, one.gain.total)
        if one.last is not None:
            best.setdefault((one.round, one.last.effect, one.last.target), one)
    found = []
    for one in best.values():
        behind = 2 * (most[one.round] - one.gain.total)
        assert one.last is not None
        found.append(Rival(one.last, behind, one.judged.ratio, one.round, one.reason))
    return tuple(found)


_SIZES = (0.6, 0.75, 0.9, 1.1, 1.3, 1.5)
_CLOSEST = 2
"""So many of these are fitted: one simulation ranks them well, a fit hardly moves them."""
_MOST_WINDOWS = 96
"""What final fits take: as many as `windows_enough` has fitted of 144."""
