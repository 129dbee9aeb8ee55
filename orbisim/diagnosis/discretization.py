"""What a scene and a recording leave open between samples, as part of what is compared.

A machine has no timestep; a scene's is a choice of who declared it. One that is too long bends free
runs as a fast clock, a damping or a late sensor would. And a log says what a control was when the
samples were taken, not when it changed: a controller that runs at a slower rate, or beside the
logger, changes it somewhere between two samples, half an interval before the log shows it on
average; one that is logged by the loop that reads the sensors changes it a fixed part of an
interval before. Sensors that are earlier than the clock would be named for that.

So other steps, forms of friction (`Stepping`), and controls that lead their samples, are moves like
any other, with the odds of an effect. Steps, and changes by a clock that the log shows, come before
effects: what no machine has is no reason to name what it may have. A share of an interval by which
controls lead may stand in for a little of an effect that is missing: it is taken if no effect does
more. All are undone where the scene or the log as it was is worth no less. While much is left, a
search takes as few steps between samples as hardly show beside that (`coarsened`).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.worth import gains, worth
from orbisim.evidence import EFFECT
from orbisim.recording.command_clock import Lead
from orbisim.shooting.bench import Bench
from orbisim.shooting.forms import command_clock, foreseen_anew, linearized, untimed
from orbisim.shooting.halving import MATTERS, coarsest, difference, exact_enough, matters
from orbisim.shooting.judge import Judged
from orbisim.shooting.stepping import Stepping, stepping
from orbisim.shooting.timestep import held, is_exact, lengths, peak, stepped, taken

Other = tuple[Context, Judged]


def settled(context: Context, judged: Judged, declared: Stepping | None = None) -> Other | None:
    """The same explanation with a finer step, or controls by the clock that logs show, or another
    lead where controls have one, as long as that surely predicts better; None if it does not. No
    machine has a timestep, and a log's clock is read off the log: neither has to wait for effects.

    Args:
      declared: how the scene as it was given is stepped; the same as the bench's if None.
    """
    found = _back(context, judged, declared) or _exactly(context, judged)
    found = _followed(*(found or (context, judged))) or found
    now = found or (context, judged)
    clock = command_clock(now[0].bench)
    return _surest(*now, _led(*now, clock, (0.0, -_NEAR, _NEAR)) if clock else ()) or found


def _exactly(context: Context, judged: Judged) -> Other | None:
    """The same explanation in exact steps, if these are needed and worth more. They need not be
    sure: they are what the scene says, and forces half a step early look like a sensor's time."""
    found = _again(context, judged, exact_enough)
    if found is None or not worth(context.bench, judged, found[1]).total + EFFECT > 0:
        return None
    return _taken(found)


def _back(context: Context, judged: Judged, declared: Stepping | None) -> Other | None:
    """The same explanation in the declared steps, if they are others and predict better: steps that
    are exact of the bare scene need not be through dry friction, and what they leave is named."""
    if declared is None or stepping(context.bench.scene) == declared:
        return None
    found = _again(context, judged, lambda bench: stepped(bench, **declared._asdict()))
    return _taken(found) if found is not None and found[1].loss < judged.loss else None


def coarsened(context: Context, judged: Judged, given: Stepping) -> Other | None:
    """The same explanation in as few steps as hardly change it, beside what is left and may still
    be in the end; None where these, finer or exact ones are what there is.

    Args:
      given: how the scene as it was given is stepped.
    """
    there, now = as_given(context, given).bench, stepping(context.bench.scene)
    if stepping(there.scene) != given._replace(dry=now.dry):
        return None
    most = MATTERS * max(judged.ratio / _FALLS, 1.0)
    bench = coarsest(there, most, judged.hypothesis)
    found = None if stepping(bench.scene) == now else _again(context, judged, lambda _: bench)
    return None if found is None else _taken(found)


def as_given(context: Context, given: Stepping) -> Context:
    """In the steps of the scene as it was given, where there are longer ones of its integrator."""
    now = stepping(context.bench.scene)
    if now.integrator != given.integrator or now.timestep <= given.timestep:
        return context
    return context.trying(stepped(context.bench, given.timestep))


def earlier(context: Context, judged: Judged) -> Other | None:
    """The same explanation with controls that lead (or follow) their samples by the share of an
    interval that predicts best, and the step that then does, if that is surely better; None if not.
    As long as an effect is missing, a share may stand in for a part of it. It may also stand in the
    place of effects that change when things are seen or done: if all sensors are early alike,
    commands act before they are logged, if they are late alike, after that.
    """
    if context.bench.lead is None or context.bench.lead:
        return None
    return _surest(context, judged, _led(context, judged, Lead(), (0.0, *_SHARES)))


def _led(context: Context, judged: Judged, lead: Lead, tried: Sequence[float]) -> Iterator[Other]:
    """With a lead by the share of an interval that predicts best, and the step that then does: the
    same explanation, and what it is without effects that change when things are seen or done."""
    for one, more in ((judged, ()), *untimed(context.bench, judged)):
        near = (share for share in more if abs(share) <= _most(lead))
        other = _begun(context, one, lead, (*tried, *near))
        if other is not None and other[0].bench.lead:
            there, found = _followed(*other, within=bool(more)) or other
            yield there, there.judge.closer(found)


def _followed(context: Context, judged: Judged, within: bool = False) -> Other | None:
    """With other steps and another lead in turns, as long as one surely predicts better: a lead
    makes up for a part of a step that is too long, so that each is looked for again with the other.

    Args:
      within: as of `_finer`.
    """
    found, finer = None, functools.partial(_finer, within=within)
    frictions = ["dry"] if judged.hypothesis.rubs(context.bench.scene) else []
    frictions += ["elliptic"] if context.bench.contacts else []
    while True:
        tried = [form(context, judged) for form in (finer, _held, _retimed)]
        tried += [_other_friction(context, judged, **{form: True}) for form in frictions]
        better = _surest(context, judged, tried)
        if better is None:
            return found
        found = context, judged = better


def _surest(context: Context, judged: Judged, tried: Iterable[Other | None]) -> Other | None:
    """The form that is surely worth most, if one is: through impacts beside the explanation in the
    form that there is, fitted from the same starts, too, as a fit stays where it began."""
    found, bench, judge = [one for one in tried if one], context.bench, context.judge
    known = gains(bench, judged, [one[1] for one in found])
    best = max(range(len(found)), key=lambda i: known[i].sure, default=None)
    if best is None or not known[best].sure + EFFECT > 0:
        return None
    there = found[best][1]
    again = judge.judge(judged.hypothesis, begin=judge.begin(there)) if bench.contacts else None
    sure = again is None or worth(bench, again, there).sure + EFFECT > 0
    return _taken(found[best]) if sure else None


def as_declared(context: Context, judged: Judged, declared: Stepping) -> Other | None:
    """The same explanation with controls as they were logged, the integrator of the scene, or twice
    the step, as often as that is worth no less and the step no longer than declared; None if it
    does not.

    Args:
      declared: how the scene as it was given is stepped.
    """

    def coarser(bench: Bench) -> Bench | None:
        step, most = 2 * taken(bench), taken(bench, declared.timestep)
        if stepping(bench.scene).integrator != declared.integrator:
            step = min(taken(bench), most)
        if step > most and not np.isclose(step, most):
            return None
        step = declared.timestep if np.isclose(step, most) else step
        return stepped(bench, step, integrator=declared.integrator)

    def logged(bench: Bench) -> Bench | None:
        return bench.led(Lead()) if bench.lead else None

    def softer(bench: Bench, form: str) -> Bench | None:
        known = stepping(bench.scene)
        more = getattr(known, form) > getattr(declared, form)
        return stepped(bench, known.timestep, **{form: False}) if more else None

    found, soft = None, (functools.partial(softer, form=form) for form in ("dry", "elliptic"))
    changes: tuple[Callable[[Bench], Bench | None], ...] = (logged, *soft, coarser)
    for change in changes:
        while (one := _again(context, judged, change)) is not None:
            if not worth(context.bench, judged, one[1]).total - EFFECT > 0:
                break
            found = context, judged = _taken(one)
    return found


def _again(
    context: Context, judged: Judged, change: Callable[[Bench], Bench | None]
) -> Other | None:
    """An explanation, fitted again with another form of the data, without effects that are
    impossible in it (`Judge.possible`); None where there is none. The derivatives that a fit begins
    with are those along the form that there was: they hardly differ, and take longer than it."""
    bench = change(context.bench)
    if bench is None:
        return None
    there = context.trying(bench)
    again = there.judge.judge(judged.hypothesis, begin=context.judge.begin(judged))
    return None if again is None else (there, there.judge.possible(again))


def _taken(one: Other) -> Other:
    """With derivatives along the form that was tried."""
    context, judged = one
    return context.on(linearized(context.bench)), judged


def reasked(context: Context, judged: Judged) -> Other:
    """In a form that was taken, and compared by what impacts left unknown before: with what they do
    there (less, in finer steps), and fitted again."""
    bench = foreseen_anew(context.bench)
    if bench is context.bench:
        return context, judged
    there = context.on(bench)
    return there, there.judge.judge(judged.hypothesis, begin=there.judge.begin(judged)) or judged


def _finer(context: Context, judged: Judged, within: bool = False) -> Other | None:
    """The same explanation with half of the step, a quarter, ... as long as that is better and the
    error of the step matters; None where the step as it is predicts best.

    The error of MuJoCo's other integrators falls as the step does (what they hold over a step, they
    hold for a time of its length): half the step changes as much as it leaves.

    Args:
      within: whether it is compared with what has no commands that change within steps, which blur
        them however little they do else.
    """
    enough = context.bench.contacts and taken(context.bench) <= _SHORT_FOR_IMPACTS
    if enough or not (within or matters(context.bench, 1.0, judged.hypothesis)):
        return None
    step, best, bench, fitted = taken(context.bench), 0.0, context.bench, None
    for _ in range(_HALVINGS):
        step, finer = step / 2.0, stepped(context.bench, step / 2.0)
        gain, fit = _gain(context, judged, finer)
        if not gain > best:
            break
        best, bench, fitted = gain, finer, fit
        if bench.contacts and step <= _SHORT_FOR_IMPACTS:
            break
        if not matters(finer, judged.ratio, judged.hypothesis):
            break
    return fitted or (_again(context, judged, lambda _: bench) if best > 0 else None)


def resolved(context: Context, judged: Judged) -> Other:
    """Where bodies touch, the declared scene in finer steps, if these surely predict better: before
    starts are looked for again, as these make up for a part of the error of a step."""
    finer = _finer(context, judged) if context.bench.contacts else None
    found = _surest(context, judged, [finer])
    return (context, judged) if found is None else reasked(*found)


def _held(context: Context, judged: Judged) -> Other | None:
    """The same explanation in steps over which forces are held, instead of exact ones or ones of
    another length, of the length that predicts best: a simulated machine has steps of its own, and
    what they do would be named as an inertia or a damping (MuJoCo's implicit damping adds its
    product with the step to the inertia). What they do grows as the step does, so that three
    lengths tell the best."""
    bench, tried = context.bench, lengths(context.bench)
    if bench.contacts and not is_exact(bench):
        return None
    if not difference(bench, held(bench, tried[-1])) > MATTERS * max(judged.ratio, 1.0):
        return None
    long, known = max(tried), 0.0 if is_exact(bench) else taken(bench)
    ends = long / _SHORTEST, 2.0 * long
    return _best(context, judged, held, tried, (known,), ends, long / _LIKE, 1)


def _other_friction(context: Context, judged: Judged, **form: bool) -> Other | None:
    """The same explanation with another form of friction (`Stepping`), where that matters: `dry`,
    as a simulated machine may have it (what that does at rest would be named, or hide what tells
    one friction from another), or `elliptic`, as no floor knows directions, and what friction along
    the edges of a pyramid is larger by would be named."""
    known = stepping(context.bench.scene)
    other = stepped(context.bench, known.timestep, **form)
    if stepping(other.scene) == known:
        return None
    if not difference(context.bench, other, judged.hypothesis) > MATTERS:
        return None
    return _again(context, judged, lambda _: other)


def _gain(context: Context, judged: Judged, bench: Bench | None) -> tuple[float, Other | None]:
    """By how much less the same explanation leaves in another form of the data, as it is foreseen
    (a fit takes ten times as long), and the fit where it cannot be."""
    gain = None if bench is None else context.trying(bench).judge.foreseen(judged, context.judge)
    if gain is not None:
        return gain, None
    fitted = _again(context, judged, lambda _: bench)
    return (-np.inf, None) if fitted is None else (judged.loss - fitted[1].loss, fitted)


def _best(
    context: Context,
    judged: Judged,
    change: Callable[[Bench, float], Bench | None],
    tried: Sequence[float],
    known: Sequence[float],
    ends: tuple[float, float],
    close: float,
    refined: int,
) -> Other | None:
    """The same explanation in the best of a line of forms: at a place that is tried, or where a
    parabola through these is highest. None if none is better.

    Args:
      known: places that are what there is. ends: of the line. close: distance of places alike.
      refined: places tried after these at most.
    """
    gains, fits = dict.fromkeys(known, 0.0), dict[float, Other | None]()
    for place in tried:
        gains[place], fits[place] = _gain(context, judged, change(context.bench, place))
    for _ in range(refined):
        top = peak(gains, *ends)
        if top is None or min(abs(top - one) for one in gains) < close:
            break
        gains[top], fits[top] = _gain(context, judged, change(context.bench, top))
    best = max(gains, key=lambda place: gains[place])
    if best in known:
        return None
    return fits[best] or _again(context, judged, lambda bench: change(bench, best))


_FALLS = 10.0
"""Times by which what is left may fall: real machines' models leave a fortieth to a quarter."""
_SHORTEST, _LIKE = 8, 32
"""Shares of the longest of the steps that are tried first: the shortest, which is as good as exact,
and by which steps differ that are tried."""
_HALVINGS = 5
"""At once: a simulation takes as many times as long."""
_SHORT_FOR_IMPACTS = 4e-4
"""Steps, s, that are short enough where bodies touch: a fiftieth of the time constant of MuJoCo's
contacts, 20 ms by default."""


def _begun(context: Context, judged: Judged, lead: Lead, tried: Sequence[float]) -> Other | None:
    """With the lead that predicts best, of the steps that there are or of exact ones. Forces act
    half a step early: a step that is too long may happen to make up for when controls change, and
    then neither is better without the other."""
    benches = [one for one in (context.bench, exact_enough(context.bench)) if one is not None]
    forms = [_led_best(context.trying(one), judged, lead, tried) for one in benches]
    return min((one for one in forms if one), key=lambda one: one[1].loss, default=None)


def _retimed(context: Context, judged: Judged) -> Other | None:
    """With another lead near the one that there is."""
    lead = context.bench.lead
    if not lead:
        return None
    near = [place for place in (lead.share - _NEAR, lead.share + _NEAR) if abs(place) <= 1]
    return _led_best(context, judged, lead, near, (lead.share,))


def _led_best(
    context: Context,
    judged: Judged,
    lead: Lead,
    tried: Sequence[float],
    known: Sequence[float] = (),
) -> Other | None:
    """The same explanation with controls that lead by the share of an interval that predicts best
    (`_best`)."""
    most = _most(lead)

    def change(bench: Bench, share: float) -> Bench:
        return bench.led(dataclasses.replace(lead, share=share))

    return _best(context, judged, change, tried, known, (-most, most), _CLOSE, _REFINED)


def _most(lead: Lead) -> float:
    """Share of an interval by which controls may be off; a clock is off by half of one at most."""
    return 0.5 if lead.clock else 1.0


_SHARES = (-0.5, 0.05, 0.5)
"""Of an interval, tried first: commands that arrive late, half a step of a simulation with ten
steps a sample, and changes anywhere between two samples."""
_REFINED = 3
"""Shares tried after these: a parabola's peak lies within `_CLOSE` by then."""
_NEAR = 0.1
"""Of an interval, by which other shares than the one that there is are tried first."""
_CLOSE = 0.003
"""Of an interval, that free runs do not tell apart: 15 us at 200 Hz."""
