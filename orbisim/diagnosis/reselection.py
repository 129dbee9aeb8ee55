"""Sets of effects, fitted together without what they do not need, and put in another's place."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.discretization import settled
from orbisim.diagnosis.explanations import Found, done
from orbisim.diagnosis.simplification import Sure, in_form, pruned
from orbisim.diagnosis.together import propose_anew
from orbisim.diagnosis.worth import worth
from orbisim.host.deadline import Deadline, TimeIsUpError
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, Judged


def reselected(found: Found) -> Found:
    """With another set of effects in the place of what is there, if that is surely worth more, in
    the form of the data that predicts best with it.

    What is chosen while much is left is chosen along a motion that late sensors and missing forces
    bend, and beside a timestep that makes up for a part. Along the free runs of what was found, all
    effects are selected as if none had been: one that does what several did is then seen.
    """
    best, whole = found.best, found.context.deadline
    if not best.hypothesis.effects or found.context.bench.contacts:
        return found
    found.context.say("effects selected anew")
    context = found.context.until(Deadline.after(_OF_TIME * whole.left))
    settings = context.settings
    # where nothing is left, only what takes no more effects can be worth more
    most = len(best.hypothesis.effects) if done(context, best) else settings.most_effects
    try:
        other = propose_anew(context.bench, best, settings.effects, most)
        if other is None or _places(other) == _places(best.hypothesis):
            return found
        for judged in fitted_set(context, other, best):
            form = context, judged
            if _places(judged.hypothesis) != _places(best.hypothesis):
                with contextlib.suppress(TimeIsUpError):  # the next round looks for it again
                    form = settled(*form, found.stepping) or form
            if worth(form[0].bench, best, form[1]).sure > 0:
                return in_form(found, (form[0].until(whole), form[1]))
    except TimeIsUpError:
        return dataclasses.replace(found, late=whole.passed)
    return found


_OF_TIME = 0.25
"""Share of the time left: what is there may still be added to."""


def _places(hypothesis: Hypothesis) -> set[tuple[str, str]]:
    return {(one.effect, one.target) for one in hypothesis.effects}


def fitted_set(
    context: Context, together: Hypothesis, begin: Judged | None = None
) -> Iterator[Judged]:
    """Many effects, fitted together, without those that are not surely worth it beside the others:
    a dozen cost too much to be compared with one. Nothing if they cannot be simulated.

    Args:
      begin: where windows start as there; as measured if None.
    """
    bench, windows = context.bench, context.settings.windows
    judge = Judge(bench, context.intervals, (), None, windows, True, context.chance)

    def refit(less: Hypothesis, now: Judged) -> Judged | None:
        return judge.judge(less, begin=judge.begin(now))

    start = None if begin is None else judge.begin(begin)
    judged = judge.judge(together, _ITERATIONS, begin=start)
    if judged is not None:
        yield from _last(pruned(context, judged, refit))


def _last(every: Iterator[Sure]) -> Iterator[Judged]:
    """The last; that which they had come to when the time was up, where it was."""
    last: Sure | None = None
    try:
        for last in every:  # noqa: B007
            pass
    finally:
        if last is not None:
            yield last.judged


_ITERATIONS = 8
"""Of a fit of many effects at once, which begins far off."""
