"""From a residual to the effects that explain it: forward selection with removal."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from orbisim.diagnosis.bench import SAME, Bench, Hypothesis
from orbisim.diagnosis.conclusion import Attribution, conclude, sure
from orbisim.diagnosis.joint import propose
from orbisim.diagnosis.paying import few_bad, settles, strain, unpaid
from orbisim.diagnosis.refine import Judge, Judged
from orbisim.diagnosis.relieving import gathered, relieved
from orbisim.diagnosis.rounds import best_addition, best_with_retuning, numbers, tied
from orbisim.diagnosis.screening import cleaned
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import NEAR, Progress, SearchState, quiet
from orbisim.diagnosis.suspects import Screening
from orbisim.diagnosis.swapping import swapped, united
from orbisim.diagnosis.worth import worth
from orbisim.effects import EffectInstance


def attribute(bench: Bench, settings: Settings, say: Progress = lambda _: None) -> Attribution:
    """Searches for the effects that a scene lacks."""
    state = SearchState(bench, settings, say)
    state.say("fitting the declared scene")
    nothing = state.declared = state.need(Hypothesis())
    if quiet(settings, nothing):
        return conclude(state, nothing, None)
    state.find_tunables()
    state.say("screening effects")
    first = state.screen(nothing)
    found = _explain(state, nothing, first)
    if not state.heavy:
        found = united(state, swapped(state, found))
    return conclude(state, found, first)


def _explain(state: SearchState, nothing: Judged, first: Screening) -> Judged:
    """One effect if it is all; else declared parameters; else effects and parameters."""
    single = best_addition(state, nothing, first.suspects, first)
    stopped = single is not None and settles(nothing, single)
    single = None if single is None else swapped(state, state.renewed(single))
    alone = single if single is not None and _sufficient(state, single) else None
    if alone is not None:
        rivals = _rivals(state, alone)
        if not rivals and alone.hypothesis.effects[0].effect not in SAME:
            return alone
    tuned = state.tuned(Hypothesis())
    if tuned is not None and _explained(state, tuned) and _outdoes(tuned, alone, stopped):
        return gathered(state, tuned)
    if alone is not None:
        other = _retuned(state, tuned, first, rivals) if rivals else None
        if other is None or not _preferable(state, other, alone):
            return alone
        return alone if stopped and few_bad(other) else other
    return _several(state, nothing, single, tuned, first)


def _outdoes(tuned: Judged, alone: Judged | None, stopped: bool) -> bool:
    """Whether retuned parameters are better than a single effect, if there is one.

    Args:
      stopped: whether that is a stop, and makes the few windows good that were bad.
    """
    if alone is None:
        return True
    return tuned.cost < alone.cost and not (stopped and few_bad(tuned))


def _several(
    state: SearchState,
    nothing: Judged,
    single: Judged | None,
    tuned: Judged | None,
    first: Screening,
) -> Judged:
    """Where one effect is not all: one with declared parameters retuned, two at once, or ever more.

    Args:
      single: the best single effect that pays. tuned: the declared parameters retuned.
    """
    retuned, best = _retuned(state, tuned, first), None
    if not state.bench.contacts or single is None or _excess(single) > _MOST * _excess(nothing):
        best = _paired(state, nothing, single, first)
        best = None if best is None else state.prune(best)
    best = best or single
    if best is not None:
        best = state.renewed(best)
    ends = [one for one in (retuned, best) if one is not None and _explained(state, one)]
    if ends:
        return min(ends, key=lambda one: one.cost)
    starts = [one for one in (retuned, best and state.tuned(best.hypothesis)) if one is not None]
    start = min(starts, key=lambda one: one.cost) if starts else best or tuned or nothing
    together = _jointly(state, start)
    if together is not None:
        return together
    if start is nothing or _explained(state, start):
        return state.untuned(state.prune(start, newest=True))
    return _forward(state, start, tuned or nothing, first)


def _retuned(
    state: SearchState,
    tuned: Judged | None,
    first: Screening,
    only: Sequence[EffectInstance] | None = None,
) -> Judged | None:
    """The best single effect with declared parameters retuned.

    Args:
      only: the effects to try; all if None. Where bodies touch these are ranked anew then: along
        the retuned scene the motion is another.
    """
    if tuned is None or state.late:
        return None
    if only is None and state.bench.contacts:
        state.renew(tuned.hypothesis)
        state.judge.start_from(tuned)
        state.say("screening effects with declared parameters retuned")
        found = best_addition(state, tuned, (again := state.screen(tuned)).tuned, again)
    else:
        found = best_with_retuning(state, tuned, first, only)
    return None if found is None else state.renewed(found)


def _preferable(state: SearchState, one: Judged, other: Judged) -> bool:
    """Whether one explanation is better than another by more than chance, or as good with an effect
    of fewer numbers: of what declared parameters that are a little off do, an effect with many can
    do some by chance."""
    model = state.bench.scene.model
    if numbers(model, one.hypothesis.effects) < numbers(model, other.hypothesis.effects):
        return one.cost < other.cost or tied(one, other)
    return one.cost < other.cost - state.settings.margin


def _rivals(state: SearchState, single: Judged) -> list[EffectInstance]:
    """Other effects that do nearly as well as the best with no more numbers: as long as parameters
    are as declared, which one is better may be a matter of those. Where the best is one that is
    also declared, a mass, they are the parameters that may be off: then every simpler one counts.
    """
    model, best = state.bench.scene.model, single.hypothesis.effects[0]
    most = numbers(model, [best])
    first = [r for r in state.rivals if r.round == 1 and r.delta_bic > 0]
    near = [r.instance for r in first if r.delta_bic < _NEARLY]
    found = [one for one in near if numbers(model, [one]) <= most][:_FEW]
    if best.effect not in SAME or state.bench.contacts:
        return found
    simpler = [r.instance for r in first if r.pays and numbers(model, [r.instance]) < most]
    simpler.sort(key=lambda one: numbers(model, [one]))
    return [*(one for one in found if one not in simpler), *simpler][:_SIMPLER]


def _excess(judged: Judged) -> float:
    """Mean square of the residual beyond the noise."""
    return max(judged.ratio**2 - 1.0, 0.0)


def _explained(state: SearchState, judged: Judged) -> bool:
    """Whether no more is left to explain, and no declared parameter would have to be far off."""
    return _sufficient(state, judged) and not strain(judged.hypothesis)


def _sufficient(state: SearchState, judged: Judged) -> bool:
    """Whether what is left is not worth another effect: nothing, or where bodies touch, as no start
    brings some impacts about, a trace of what the declared scene leaves."""
    if state.done(judged):
        return True
    declared = state.declared
    if declared is None or not state.bench.contacts or judged.ratio > _CLOSE:
        return False
    return _excess(judged) < _TRACE * _excess(declared)


def _paired(
    state: SearchState, nothing: Judged, single: Judged | None, first: Screening
) -> Judged | None:
    """Two effects at once, if they do much better than the best single one."""
    state.renew(Hypothesis())
    state.judge.start_from(nothing)
    fitted: list[Judged] = []
    for pair in first.pairs[: state.settings.shortlist]:
        one, other = (cleaned(state.bench, suspect) for suspect in pair)
        if one is None or other is None or state.late:
            continue
        state.say(f"fitting {one.effect} at {one.target} and {other.effect} at {other.target}")
        judged = state.judge.judge(Hypothesis((one, other)), state.iterations)
        if judged is not None:
            fitted.append(judged)
            if sum(state.done(one) for one in fitted) > _FEW:
                break
    if not fitted:
        return None
    few = sorted(fitted, key=lambda judged: judged.cost)[:_FEW]
    few = sorted((state.judge.closer(one) for one in few), key=lambda judged: judged.cost)
    level = [judged for judged in few if tied(judged, few[0])]
    model = state.bench.scene.model
    best = min(level, key=lambda one: (numbers(model, one.hypothesis.effects), one.cost))
    rival = nothing if single is None else single
    problem = unpaid(state.settings, rival, best)
    if not state.done(best) and best.ratio > _HALF * rival.ratio:
        problem = "two effects at once leave more than half of what the best single one leaves"
    if problem is not None:
        alone = {(r.instance.effect, r.instance.target) for r in state.rivals}
        state.rejected += [
            (e, f"with another at once: {problem}")
            for e in best.hypothesis.effects
            if (e.effect, e.target) not in alone
        ]
    return best if problem is None else None


def _jointly(state: SearchState, rival: Judged) -> Judged | None:
    """Several effects at once, if they surely predict better than what was found before."""
    if state.bench.contacts or rival.ratio <= NEAR:
        return None
    state.say("several effects at once")
    bench, settings = state.given, state.settings
    effects = propose(bench, bench.intervals, settings.effects, _TOGETHER)
    if not effects:
        return None
    judge = Judge(bench, bench.intervals, (), None, settings.windows, None, heavy=True)
    nothing = judge.judge(Hypothesis(), 6)
    fitted = judge.judge(Hypothesis(effects), _ITERATIONS)
    if fitted is None or nothing is None:
        return None
    fitted = sure(state, judge, nothing, fitted)
    plain = dataclasses.replace(rival.hypothesis, factors=())
    other = nothing if not plain.effects else judge.judge(plain, _ITERATIONS)
    model = bench.scene.model
    if fitted is nothing or (other is not None and worth(model, other, fitted).sure <= 0):
        return None
    state.restart(judge)
    return fitted


def _forward(state: SearchState, start: Judged, base: Judged, first: Screening) -> Judged:
    """Adds effects while they pay, from one start or, if that ends worse, from the other."""
    current = _add_all(state, start)
    again = base is not start and not _sufficient(state, current) and not state.late
    if again and state.tunables:
        state.say("looking again with declared parameters retuned")
        state.renew(base.hypothesis)
        winner = best_addition(state, base, first.tuned, first)
        if winner is not None and winner.hypothesis.effects[0] != start.hypothesis.effects[0]:
            other = _add_all(state, state.renewed(winner))
            if other.ratio < current.ratio:
                current = other
    return state.untuned(state.prune(current, newest=True))


def _add_all(state: SearchState, current: Judged) -> Judged:
    while len(current.hypothesis.effects) < state.settings.most_effects and not state.late:
        if _explained(state, current):
            return gathered(state, current)
        other = relieved(state, current) if state.done(current) else None
        if other is not None:
            current = state.renewed(state.prune(other))
            continue
        state.say(f"screening what is left ({current.ratio:.3g} times the noise)")
        found = state.screen(current)
        suspects = found.tuned if current.hypothesis.factors else found.suspects
        winner = best_addition(state, current, suspects, found)
        if winner is None:
            return current
        current = state.renewed(state.prune(winner))
        if not _explained(state, current):
            current = swapped(state, current)
    return current


_TOGETHER = 12
"""Effects at most that are selected together."""
_ITERATIONS = 8
_HALF = 0.5
_MOST = 0.2
_CLOSE = 1.3
"""Residual over noise that impacts may leave."""
_TRACE = 0.1
"""Share of the declared scene's mean square beyond the noise that they may leave besides."""
_NEARLY = 130.0
_FEW = 2
_SIMPLER = 8
