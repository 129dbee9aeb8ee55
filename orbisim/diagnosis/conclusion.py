"""The end of a search: the fit on all windows, the last doubts, and what each effect brings."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Bench, Hypothesis
from orbisim.diagnosis.consistency import absurd
from orbisim.diagnosis.laws import imitated
from orbisim.diagnosis.paying import strain
from orbisim.diagnosis.refine import Judge, Judged
from orbisim.diagnosis.rounds import ROUNDED, TIE, hollowed, numbers
from orbisim.diagnosis.samples import Samples
from orbisim.diagnosis.state import NEAR, Rival, SearchState
from orbisim.diagnosis.suspects import Screening
from orbisim.diagnosis.worth import worth
from orbisim.effects import EffectInstance, find

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Attribution:
    """What the search found.

    Attributes:
      bench: the data, with the noise as it was known in the end.
      before, after: the declared scene and the final hypothesis, fitted on all windows.
      first: screening of the declared scene; None if nothing had to be explained.
      rivals: fitted suspects of all rounds.
      evidence: for each effect the drop in information criterion that it brings.
      rejected: effects that lowered the residual but were not believed, with the reason.
      cut_short: whether the search ended because its time was up.
      rugged: whether effects on contacts leave more than noise where bodies touch: their intervals
        then say less than they seem to.
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

    @property
    def samples(self) -> tuple[Samples, ...]:
        """The recordings that were fitted."""
        return self.bench.samples

    @property
    def hypothesis(self) -> Hypothesis:
        """The effects, with fitted values."""
        return self.after.hypothesis


def conclude(state: SearchState, current: Judged, first: Screening | None) -> Attribution:
    """Fits on all windows and weighs each effect."""
    state.say("final fit")
    if current.hypothesis.effects or current.hypothesis.factors:
        state.renew(current.hypothesis)
    whole = state.bench.whole()
    judge = Judge(
        whole, state.intervals, state.tunables, state.columns, _MOST_WINDOWS,
        state.robust, state.heavy,
    )  # fmt: skip
    before = _finally(state, judge, state.declared or current, Hypothesis())
    assert before is not None
    after = _finally(state, judge, current, current.hypothesis) or current
    after = after if state.heavy else scanned(state, judge, duel(state, judge, after))
    if not current.hypothesis.effects and not current.hypothesis.factors:
        after = before
    else:
        if after.ratio > NEAR:
            after = sure(state, judge, before, after)
        problem = doubt(after)
        if problem is None and not state.bench.contacts:
            problem = imitated(judge, after, state.settings.margin)
        if problem is not None:
            state.rejected += [(effect, problem) for effect in current.hypothesis.effects]
            after = before
    judge.start_from(after)
    fewer = (
        judge.judge(after.hypothesis.without(index)) or before
        for index in range(len(after.hypothesis.effects))
    )
    evidence = tuple(one.cost - after.cost for one in fewer)
    after = rescaled(state, judge, after)
    return Attribution(
        state.bench, before, after, first, tuple(state.rivals), evidence,
        tuple(state.rejected), state.late and not state.done(after),
        bool(on_contacts(state, after)),
    )  # fmt: skip


def rescaled(state: SearchState, judge: Judge, after: Judged) -> Judged:
    """The same effects with final values. Where much is left and large residuals count linearly,
    large is what exceeds the scale of what is left (Huber's proposal 2), not the noise of a good
    encoder: with that nearly all of them would, and values would be those of a median."""
    if state.robust is None or state.bench.contacts or after.ratio <= NEAR:
        return after
    seen = judge.fitted.seen.reshape(len(judge.fitted), -1)
    scale = _TO_SIGMA * float(np.median(np.abs(after.fit.residual[seen])))
    if not after.hypothesis.effects or scale <= 1:
        return after
    again = Judge(
        judge.bench, state.intervals, state.tunables, state.columns, _MOST_WINDOWS,
        state.robust * scale,
    )  # fmt: skip
    again.start_from(after)
    found = again.judge(after.hypothesis, 8)
    if found is None:
        return after
    return dataclasses.replace(after, hypothesis=found.hypothesis, fit=found.fit)


_TO_SIGMA = 1.4826
"""Standard deviation over the median absolute value of a normal distribution."""


def _finally(
    state: SearchState, judge: Judge, known: Judged, hypothesis: Hypothesis
) -> Judged | None:
    """A hypothesis fitted on all windows, with what some of them alone did not determine.

    Args:
      known: what has windows' starts close to the hypothesis' own.
    """
    if state.bench.contacts:  # a start from nothing takes long
        judge.start_from(known, state.bench.fit)
    anew = dataclasses.replace(hypothesis, frozen=frozenset())
    found = judge.judge(anew, 8 if hypothesis.effects else 5)
    if found is None or state.bench.contacts or found.ratio <= NEAR or not hypothesis.effects:
        return found
    judge.start_from(known, state.bench.fit)  # a start from nothing may be no good: a stop
    warm = judge.judge(anew, 8)
    return found if warm is None or found.cost <= warm.cost else warm


def duel(state: SearchState, judge: Judge, after: Judged) -> Judged:
    """The best of the final effect and of its nearest rivals, now on all windows."""
    effects, best = after.hypothesis.effects, after
    if not effects:
        return after
    last = effects[-1]
    rounds = {r.round for r in state.rivals if _same(r.instance, last) and not r.reason}
    near = [
        rival
        for rival in state.rivals
        if rival.pays and rival.round in rounds and not _same(rival.instance, last)
        if abs(rival.delta_bic) < state.settings.margin
    ]
    judge.start_from(after)
    for rival in sorted(near, key=lambda r: r.delta_bic)[:_DUELS]:
        other = dataclasses.replace(
            after.hypothesis.without(len(effects) - 1).plus(rival.instance),
            factors=after.hypothesis.factors,
        )
        judged = judge.judge(other, 8)
        if judged is None or hollowed(state, judged):
            continue
        if judged.cost < best.cost - _needed(state, other, best):
            best = judged
    if best is not after:
        found = best.hypothesis.effects[-1]
        reason = f"on all windows, {found.effect} at {found.target} explains more"
        state.rivals = [
            dataclasses.replace(r, reason=reason) if _same(r.instance, last) else r
            for r in state.rivals
        ]
    return best


def scanned(state: SearchState, judge: Judge, after: Judged) -> Judged:
    """The same effects with other numbers of contacts, where bodies touch and more than noise is
    left: through impacts the cost is rugged, and a fit stays where it began. The first parameter of
    each such effect is tried at other sizes, the rest fitted."""
    model, best = state.bench.scene.model, after
    for number in on_contacts(state, after):
        effect = after.hypothesis.effects[number]
        name = find(effect.effect).free_parameters(model, effect.target)[0]
        state.say(f"trying other sizes of {effect.effect} at {effect.target}")
        for sizes in (_COARSE, _FINE):
            best = _resized(judge, best, (number, name), sizes)
    if best is not after:
        judge.start_from(best)
    return best


def on_contacts(state: SearchState, after: Judged) -> list[int]:
    """Numbers of the effects on contacts, if bodies touch and more than noise is left."""
    if not state.bench.contacts or after.ratio <= NEAR:
        return []
    effects = after.hypothesis.effects
    return [i for i, e in enumerate(effects) if find(e.effect).kind == "geom"]


def _resized(
    judge: Judge, judged: Judged, which: tuple[int, str], sizes: tuple[float, ...]
) -> Judged:
    """The best with one number so many times as large, then fitted."""
    number, name = which
    own, tried = judged.hypothesis.effects[number], []
    for size in sizes:
        other = own.replace(**{name: size * own.values[name]})
        effects = list(judged.hypothesis.effects)
        effects[number] = other
        held = dataclasses.replace(
            judged.hypothesis, effects=tuple(effects), frozen=judged.hypothesis.frozen | {which}
        )
        judge.start_from(judged)
        one = judge.judge(held, 5, polish=False)
        tried += [one] if one is not None else []
    if not tried:
        return judged
    first = min(tried, key=lambda one: one.cost)
    judge.start_from(first)
    free = dataclasses.replace(first.hypothesis, frozen=first.hypothesis.frozen - {which})
    found = judge.judge(free, 5, polish=False)
    return found if found is not None and found.cost < judged.cost else judged


_COARSE = (0.6, 0.7, 0.8, 0.9, 1.1, 1.2, 1.35, 1.5)
_FINE = (0.94, 0.97, 1.03, 1.06)


def _same(one: EffectInstance, other: EffectInstance) -> bool:
    return (one.effect, one.target) == (other.effect, other.target)


def _needed(state: SearchState, other: Hypothesis, best: Judged) -> float:
    """By how much another explanation must be better: more than chance with more numbers, and with
    fewer it may be as good."""
    model = state.bench.scene.model
    own, others = (numbers(model, one.effects) for one in (best.hypothesis, other))
    if others == own:
        return ROUNDED
    return state.settings.margin if others > own else -TIE


_DUELS = 2


def doubt(after: Judged) -> str | None:
    """Why an explanation is none, as it takes declared parameters too far, or names no effect where
    much is left; None if it is one."""
    effects = after.hypothesis.effects
    if strain(after.hypothesis) and (after.ratio > NEAR or not effects):
        return "a declared parameter would have to be further off than any is"
    if after.ratio > NEAR and not effects:
        return "nothing surely improves prediction"
    return None


def sure(state: SearchState, judge: Judge, before: Judged, after: Judged) -> Judged:
    """An explanation that leaves more than noise, with those effects only that surely improve
    prediction beside the others; what there was before if none does.

    Args:
      before: the declared scene, judged on the same windows.
    """
    model, samples = state.bench.scene.model, state.bench.samples
    while after.hypothesis.effects:
        problems, fewer = [], []
        for index, effect in enumerate(after.hypothesis.effects):
            only = len(after.hypothesis.effects) == 1
            judge.start_from(after)
            less = before if only else judge.judge(after.hypothesis.without(index), 3)
            gain = worth(model, less or before, after)
            problem = absurd(model, effect, samples)
            if problem is None and gain.sure <= 0:
                problem = (
                    f"beside the others it is worth {gain.total:.3g} +- {gain.error:.2g} in the "
                    "logarithm of the predictive score, which is not sure"
                )
            problems.append((gain.sure if problem is None else min(gain.sure, 0.0), problem))
            fewer.append(less)
        number = min(range(len(problems)), key=lambda i: problems[i][0])
        reason = problems[number][1]
        if reason is None:
            return after
        state.rejected.append((after.hypothesis.effects[number], reason))
        after = fewer[number] or before
    return before


_MOST_WINDOWS = 96
