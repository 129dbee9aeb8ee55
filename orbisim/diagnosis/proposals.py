"""What a search may try next: effects that a screening ranks, events that no screening sees, and
what can stand in the place of what is there.

Nothing here decides; `orbisim.diagnosis.worth` does.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.glances import generalizations, shortlist
from orbisim.diagnosis.suspects import Screening, Suspect
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.effects.base import index_of, joints_of
from orbisim.effects.unnamed import UNNAMED
from orbisim.errors import OrbiSimError
from orbisim.scene import Scene
from orbisim.shooting.hypothesis import Hypothesis, clean
from orbisim.shooting.judge import Judged, is_structural

Floats = npt.NDArray[np.float64]


def additions(
    context: Context, current: Judged, screening: Screening, first: Sequence[EffectInstance]
) -> Iterator[Suspect]:
    """Effects to add: those that the screening ranks, best first.

    Args:
      first: what did best where nothing was added yet: an added joint, whose state nothing reads,
        hides what else is missing from a regression.
    """
    hypothesis = current.hypothesis
    if is_structural(hypothesis):
        taken = {(one.effect, one.target) for one in hypothesis.effects}
        yield from (Suspect(e) for e in first if (e.effect, e.target) not in taken)
    suspects = screening.tuned if hypothesis.factors else screening.suspects
    listed = shortlist(context, current, suspects)
    yield from listed
    yield from unranked(context, suspects, listed)


def unranked(
    context: Context, suspects: Sequence[Suspect], listed: Sequence[Suspect]
) -> Iterator[Suspect]:
    """The best suspects of effects whose rank says little and that are not on the list."""
    there = {one.place for one in listed}
    kept = (s for s in suspects if find(s.instance.effect).unranked and s.place not in there)
    for suspect in itertools.islice(kept, _FEW):
        if context.allowed(suspect.instance):
            yield suspect


def begin(context: Context, current: Judged, candidate: Suspect) -> Hypothesis:
    """Where a fit with an effect more begins: with the effects before as they are or, if that
    leaves less, moved; and with the effect smaller than suspected where that leaves more than there
    is without it, as small as is tried where all sizes do: with more friction than the true one a
    joint sticks, and a fit does not find back. Where bodies touch, the shortlist has seen to its
    size."""
    plus, start = current.hypothesis.plus, context.judge.begin(current)

    def glance(one: Hypothesis) -> float:
        return context.judge.glance(one, start)

    hypothesis, contacts = plus(candidate.instance), context.bench.contacts
    if not contacts and not find(candidate.instance.effect).structural:
        most = glance(current.hypothesis)
        if glance(hypothesis) > most:
            sizes = [one for share in _SMALLER if (one := candidate.sized(share)) is not None]
            smaller = [plus(one) for one in sizes] or [hypothesis]
            hypothesis = next((one for one in smaller if glance(one) < most), smaller[-1])
    moved = candidate.moved
    if moved is None or not moved.any() or is_structural(hypothesis):
        return hypothesis
    values = hypothesis.values(context.bench.scene)
    values[: len(moved)] += moved
    other = hypothesis.at(context.bench.scene, values)
    return min((hypothesis, other), key=glance)


def events(context: Context, current: Judged, shares: Floats) -> Iterator[Suspect]:
    """Effects that no regression sees, at the joints where something is left, each with those of
    its stated values that leave least."""
    model, hypothesis = context.bench.scene.model, current.hypothesis
    taken = {(e.effect, e.target) for e in hypothesis.effects}
    for name in effect_names():
        effect = find(name)
        if not effect.stated:
            continue
        for target in effect.targets(model):
            dof = int(model.jnt_dofadr[index_of(model, "joint", target)])
            here = EffectInstance(name, target, {})
            if shares[dof] < _SHARE or (name, target) in taken or not context.allowed(here):
                continue
            courses = [one.absolute[one.usable, dof] for one in context.bench.samples]
            for values in effect.places(model, target, courses):
                every = [EffectInstance(name, target, dict(one)) for one in values]
                best = _least(context, current, every)
                if best is not None:
                    yield Suspect(best)


_SHARE = 0.08
"""Share of the residual at a joint from which on events are looked for there."""


def _least(
    context: Context, current: Judged, every: Sequence[EffectInstance]
) -> EffectInstance | None:
    """What leaves least, starts alone fitted, over all windows: an event may happen in few. Of many
    values, those that a glance at each window likes best are compared; from where windows are
    measured to start, as starts that were fitted without the event pass it by."""
    best, least, begin = None, np.inf, context.judge.begin(current)
    possible: list[EffectInstance] = []
    for one in every:
        with contextlib.suppress(OrbiSimError):  # a variant that cannot be is no candidate
            possible.append(clean(context.bench.scene, one))
    if len(possible) > _FEW:
        begun = [current.hypothesis.plus(one) for one in possible]
        left = [context.judge.glance(one, begin.as_measured(), every=True) for one in begun]
        possible = [possible[i] for i in np.argsort(left, kind="stable")[:_FEW]]
    for one in possible:
        try:
            loss = context.judge.quick_loss(current.hypothesis.plus(one), begin)
        except OrbiSimError:
            continue
        if loss < least:
            best, least = one, loss
    return best


def exchanges(
    context: Context,
    current: Judged,
    index: int,
    fewer: Judged,
    others: Sequence[EffectInstance] = (),
) -> Iterator[Hypothesis]:
    """Others in the place of one effect: what is known to look the same, of a single one what did
    best (steps and times of commands may be others since), the declared parameter that it changes,
    what a screening without it ranks best, and what it is declared as (a mass) beside another one.

    Args:
      fewer: the explanation without it. others: what did best beside it in its round.
    """
    scene, own = context.bench.scene, current.hypothesis.effects[index]
    every = [*find(own.effect).equivalents(scene.model, own), *generalizations(context, own)]
    every += others[:_FEW] if len(current.hypothesis.effects) == 1 else ()
    near = [clean(scene, one) for one in every if context.allowed(one)]
    # the same effect at the same target twice is one with other numbers
    seen = {(one.effect, one.target) for one in current.hypothesis.effects}
    for one in near:
        if (one.effect, one.target) not in seen:
            seen.add((one.effect, one.target))
            yield fewer.hypothesis.plus(one)
    retuned = not current.hypothesis.factors and bool(context.tunables)
    declared_as = find(own.effect).declared_as
    if declared_as and retuned:
        known = {(one.effect, one.target): one for one in reversed((*near, *others))}
        simpler = [o for o in known.values() if _numbers(scene, o) < _numbers(scene, own)]
        for one in simpler[: -_FEW - 1 : -1]:
            yield fewer.hypothesis.plus(one).tuned(context.tunables)
    same = (declared_as, own.target)
    declared = [one for one in context.tunables if (one.kind, one.target) == same]
    if declared:
        yield fewer.hypothesis.tuned([*(one for one, _ in fewer.hypothesis.factors), *declared])
    several = len(current.hypothesis.effects) > 1 and not is_structural(current.hypothesis)
    if not (several and context.bench.contacts):  # else all are selected anew together
        return
    for suspect in context.screen(fewer).suspects[:_FEW]:
        if suspect.place not in seen:
            yield begin(context, fewer, suspect)


def _numbers(scene: Scene, one: EffectInstance) -> int:
    return len(find(one.effect).free_parameters(scene.model, one.target))


def laws(context: Context, current: Judged) -> Iterator[Hypothesis]:
    """A law without a name at a joint in the place of all effects there: what one smooth law does
    as well as several named effects, or better than one, is not to be called by their names."""
    scene, hypothesis = context.bench.scene, current.hypothesis
    model = scene.model
    places = [joints_of(model, find(e.effect).kind, e.target) for e in hypothesis.effects]
    for joint in dict.fromkeys(itertools.chain.from_iterable(places)):
        for law in UNNAMED:
            effect = law()
            if not effect.possible(model, joint):
                continue
            dof = int(model.jnt_dofadr[index_of(model, "joint", joint)])
            q = np.concatenate([one.absolute[one.usable, dof] for one in context.bench.samples])
            begun = [
                dataclasses.replace(
                    hypothesis,
                    effects=(EffectInstance(law.name, joint, values),),
                    frozen=frozenset(),
                )
                for values in effect.beginnings(q)
            ]
            start = context.judge.begin(current)
            many = len(begun) > 1
            left = [context.judge.glance(one, start) if many else 0.0 for one in begun]
            yield begun[int(np.argmin(left))]


_SMALLER = (0.5, 0.25, 0.1)
"""Shares of the size that a screening suspects, for what leaves more in that."""
_FEW = 3
"""Suspects of a screening that are tried in the place of an effect, and values of an event that are
compared by fits of the starts."""
