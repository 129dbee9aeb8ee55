"""The search: from the scene as declared to the explanation that predicts best.

A state is an explanation (`Judged`): effects with their values, retuned declared parameters,
fitted starts. A move adds effects or retunes declared parameters (`orbisim.diagnosis.moves`),
removes, exchanges or merges effects (`.simplification`), or changes the timestep or when controls
change (`.discretization`). One number decides each: what the later explanation is surely worth more
(`.worth`). The search ends where no move is, or the time is up.
"""

from __future__ import annotations

import dataclasses
import itertools

from orbisim.diagnosis.context import Context, Progress, begun
from orbisim.diagnosis.discretization import as_declared, coarsened, earlier, resolved, settled
from orbisim.diagnosis.explanations import EVEN, TO_THE_END, Found, done, quiet
from orbisim.diagnosis.moves import best_move
from orbisim.diagnosis.reselection import reselected
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.simplification import in_form, named, not_vague, removed, simplified, untuned
from orbisim.diagnosis.worth import gains, worth
from orbisim.evidence import EFFECT, NEAR
from orbisim.host.deadline import NEVER, TimeIsUpError
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.stepping import stepping


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
    given = stepping(bench.scene)
    found = Found(context, given, given, declared, declared, late=late)
    if late or quiet(settings, declared):
        return found
    try:
        context, declared = resolved(context, declared)
        found = Found(context, given, given, declared, declared)
        last = _to_the_end(context, declared)
        if quiet(settings, last):
            return dataclasses.replace(found, declared=last, best=last)
        found = dataclasses.replace(found, context=context.with_tunables())
        say("screening effects")
        found = _coarsened(found)
        found = _in_best_form(found)
        for number in itertools.count(1):
            found.context.say(f"round {number}: {found.best.ratio:.3g} times the noise")
            found = found if number == 1 else _anew(found)
            later = found if found.late else _moved(found, number)
            if later.late:
                return later
            ended, found = _ended(found, later), later
            if ended:
                return named(_in_given_steps(found))
    except TimeIsUpError:
        return dataclasses.replace(found, late=True)
    return found


def _to_the_end(context: Context, judged: Judged) -> Judged:
    """The declared scene where it is near the noise and bodies touch, restarted as long as that
    leaves less: what starts leave is nothing that is missing. Else best starts hide suspects."""
    for _ in range(_FURTHER if context.bench.contacts and judged.ratio <= NEAR else 0):
        further = context.judge.closer(judged, restarts=TO_THE_END)
        if further is judged or worth(context.bench, judged, further).total < EVEN:
            break
        judged = further
    return judged


def _coarsened(found: Found) -> Found:
    """In as few steps as hardly matter: simulation is what takes time."""
    other = coarsened(found.context, found.best, found.given)
    if other is None:
        return found
    there = stepping(other[0].bench.scene)
    return in_form(dataclasses.replace(found, stepping=there), other)


def _in_given_steps(found: Found) -> Found:
    """In the steps of the scene as it was given, instead of others that are worth no more."""
    if found.stepping == found.given:
        return found
    try:
        other = as_declared(found.context, found.best, found.given)
    except TimeIsUpError:
        return dataclasses.replace(found, late=True)
    return found if other is None else in_form(found, other)


def _ended(found: Found, later: Found) -> bool:
    """Whether a move has changed nothing, or no more than values where nothing is left or other
    values are worth nothing: a further round would try the same once more."""
    if later.best is found.best:
        return True
    (places, *form), (later_places, *later_form) = _form(found), _form(later)
    if places != later_places:
        return False
    if done(later.context, later.best):
        return True
    return form == later_form and worth(later.context.bench, found.best, later.best).total < EVEN


def _form(found: Found) -> list[object]:
    """What an explanation is but for its values: effects, parameters retuned, steps and lead."""
    hypothesis, bench = found.best.hypothesis, found.context.bench
    places = [(one.effect, one.target) for one in hypothesis.effects]
    return [places, [one for one, _ in hypothesis.factors], stepping(bench.scene), bench.lead]


def _moved(found: Found, number: int) -> Found:
    """One move more, and what it makes superfluous gone; where no addition is surely worth it, one
    that puts others in the place of what is there. The same if there is none."""
    full = len(found.best.hypothesis.effects) >= found.context.settings.most_effects
    if done(found.context, found.best) or full:
        return simplified(found, number)
    lead = earlier(found.context, found.best)
    if lead is not None and done(*lead):
        return in_form(found, lead)
    best, tried, late = best_move(found, number)
    found = dataclasses.replace(found, tried=(*found.tried, *tried))
    if lead is not None:
        worths = gains(found.context.bench, found.best, [lead[1], best or found.best])
        if best is None or worths[1].total < worths[0].total + EFFECT:
            led = in_form(found, lead)
            return dataclasses.replace(led, late=led.late or late)
    kept = found if best is None else dataclasses.replace(found, best=best)
    if late:
        return dataclasses.replace(kept, late=True)
    try:
        return simplified(found, number) if best is None else _made(found, number, best)
    except TimeIsUpError:  # what was found is the answer, and not to be lost
        return dataclasses.replace(kept, late=True)


def _anew(found: Found) -> Found:
    """In the form of the data that predicts best, without what that makes superfluous, and with
    effects selected anew. What was done before the time was up is kept."""
    there = found
    try:
        found = _in_best_form(_coarsened(there))
        if found.best is not there.best:
            found = not_vague(found)
        return reselected(found)
    except TimeIsUpError:
        return dataclasses.replace(found, late=True)


def _in_best_form(found: Found) -> Found:
    """In the form of the data that predicts best, and screened."""
    form = settled(found.context, found.best, found.stepping)
    if form is not None:
        return in_form(found, form)
    screening = found.screening or found.context.screen(found.best)
    return dataclasses.replace(found, screening=screening)


def _made(found: Found, number: int, best: Judged) -> Found:
    """The best move, and what it makes superfluous gone."""
    context, current = found.context, found.best
    fair = _fairly(context, current, best)
    if fair is not None:
        declared = found.declared if current.hypothesis.effects else fair
        return dataclasses.replace(found, best=fair, declared=declared)
    context, best = _renewed(context, best)
    found = dataclasses.replace(found, context=context, best=best)
    if not current.hypothesis.factors:
        found = untuned(found, number)
    return removed(found, number)


def _fairly(context: Context, current: Judged, better: Judged) -> Judged | None:
    """What there is, fitted again from where the better explanation has windows start, and through
    impacts restarted as often, if that is then no longer surely worth more."""
    judge = context.judge
    again = judge.judge(current.hypothesis, begin=judge.begin(better), restarts=TO_THE_END)
    if again is None or not again.loss < current.loss:
        return None
    return None if worth(context.bench, again, better).sure > 0 else again


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
        if further is None or worth(context.bench, again, further).total < EVEN:
            break
        again = further
    return (context, again) if again is not None else (context, judged)


_FURTHER = 4
"""Fits more of what was taken, each from where the last one ended."""
