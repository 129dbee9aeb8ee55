"""Several effects looked at again: whether another one in the place of each does better."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import mujoco

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.consistency import doubtful
from orbisim.diagnosis.linear import linearize
from orbisim.diagnosis.refine import Judged, is_structural
from orbisim.diagnosis.rounds import ROUNDED, begin, hollowed, numbers, tied
from orbisim.diagnosis.screening import cleaned, screen
from orbisim.diagnosis.state import NEAR, Rival, SearchState
from orbisim.diagnosis.suspects import Suspect
from orbisim.diagnosis.twins import twins
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.effects.base import index_of, names_of_kind


def swapped(state: SearchState, current: Judged) -> Judged:
    """The same explanation, with other effects where these do better given all others.

    Effects are found one after the other, and the first was chosen while the others were missing.
    Not where joints were added: that would take too long. Where bodies touch, only the last is
    looked at again.
    """
    if is_structural(current.hypothesis):
        return current
    if state.bench.contacts:
        return _kindred(state, current)
    places = [(e.effect, e.target) for e in current.hypothesis.effects]
    for place in places if len(places) > 1 else ():
        left = [(e.effect, e.target) for e in current.hypothesis.effects]
        if place in left and len(left) > 1 and not state.late:
            current = _improved(state, current, left.index(place))
    return current


def united(state: SearchState, current: Judged) -> Judged:
    """With one effect in the place of two where that does as well with no more numbers: what a
    payload does is found in parts, a force first, and none of the parts gives way to it alone. Not
    where bodies touch or joints were added: that would take too long."""
    if state.bench.contacts or is_structural(current.hypothesis):
        return current
    for one, other in itertools.combinations(range(len(current.hypothesis.effects)), 2):
        if len(current.hypothesis.effects) < _SEVERAL or state.late:
            break
        effects = current.hypothesis.effects
        fewer = state.judge.judge(current.hypothesis.without(other).without(one))
        if fewer is None:
            continue
        most = numbers(state.bench.scene.model, (effects[one], effects[other]))
        parts = f"{effects[one].effect} and {effects[other].effect}"
        state.say(f"looking for one effect instead of {parts}")
        suspects = _screened(state, fewer)[:_FIRST]
        found = [e for s in suspects if (e := cleaned(state.bench, s)) is not None]
        found += _loads(state, fewer, (effects[one], effects[other]))
        for instance in found:
            if numbers(state.bench.scene.model, [instance]) > most:
                continue
            judged = _fitted(state, fewer.hypothesis.plus(instance), current)
            if judged is None or hollowed(state, judged) or not state.pays(fewer, judged):
                continue
            if judged.cost < current.cost or tied(judged, current):
                return state.renewed(state.prune(judged, newest=True))
    return current


def _loads(
    state: SearchState, fewer: Judged, parts: Sequence[EffectInstance]
) -> list[EffectInstance]:
    """Payloads of usual sizes on the bodies that two effects act on; a regression beside what was
    fitted does not see them."""
    model, load = state.bench.scene.model, find(_IN_PARTS)
    bodies: list[str] = []
    for one in parts:
        kind = find(one.effect).kind
        if kind == "joint":
            body = model.jnt_bodyid[index_of(model, "joint", one.target)]
            bodies.append(names_of_kind(model, "body")[body])
        elif kind == "body":
            bodies.append(one.target)
    found: list[EffectInstance] = []
    state.judge.start_from(fewer)
    for name in dict.fromkeys(bodies):
        every = [
            EffectInstance(_IN_PARTS, name, dict(values)) for values in load.trials(model, name)
        ]
        every = [one for one in every if state.allowed(one)]
        if every:
            found.append(min(every, key=lambda one: state.judge.glance(fewer.hypothesis.plus(one))))
    return found


def _kindred(state: SearchState, current: Judged) -> Judged:
    """With another effect of the family of the last one, or one of its `twins`, if that does better
    once it is fitted to the end: through contacts a round stops long before, and two kinds of drag
    look alike until then."""
    effects = current.hypothesis.effects
    if not effects:
        return current
    own, best = effects[-1], current
    alike = [one for one in twins(state.bench.scene.model, own) if state.allowed(one)]
    near = [*([] if state.done(current) else _family(state, own)), *alike]
    fewer = current.hypothesis.without(len(effects) - 1)
    for instance in near:
        if state.late:
            break
        state.say(f"fitting {instance.effect} instead of {own.effect} at {own.target}")
        state.judge.start_from(current)
        judged = state.judge.judge(fewer.plus(instance), state.iterations)
        judged = None if judged is None else state.settled(judged)
        least = ROUNDED if instance in alike else state.settings.margin
        if judged is None or judged.cost >= best.cost - least or hollowed(state, judged):
            continue
        best = judged
    state.judge.start_from(best)
    if best is current:
        return current
    found = best.hypothesis.effects[-1]
    lost = f"it explains less than {found.effect} at {found.target} once both are fitted"
    names = {(own.effect, own.target): lost, (found.effect, found.target): ""}
    state.rivals = [
        dataclasses.replace(rival, reason=names[key])
        if rival.round == state.round
        and (key := (rival.instance.effect, rival.instance.target)) in names
        else rival
        for rival in state.rivals
    ]
    return state.renewed(state.prune(best))


def _family(state: SearchState, own: EffectInstance) -> list[EffectInstance]:
    """Effects of the last round at the same target and of the same family."""
    family = find(own.effect).family
    return [
        rival.instance
        for rival in state.rivals
        if rival.round == state.round and rival.instance.target == own.target
        if family and find(rival.instance.effect).family == family
        if rival.instance.effect != own.effect
    ]


def _improved(state: SearchState, current: Judged, index: int) -> Judged:
    """With the best effect in the place of one."""
    own = current.hypothesis.effects[index]
    fewer = state.judge.judge(current.hypothesis.without(index))
    if fewer is None:
        return current
    state.say(f"looking for another effect instead of {own.effect} at {own.target}")
    best = current
    for suspect in _rivals(state, current, fewer, index):
        instance = cleaned(state.bench, suspect)
        if instance is None or state.late:
            continue
        judged = _fitted(state, begin(state, fewer.hypothesis.plus(instance), suspect.moved), best)
        if judged is None or not _better(state, judged, best) or hollowed(state, judged):
            continue
        if not state.pays(fewer, judged):
            continue
        if judged.ratio > NEAR and _doubtful(state, judged):
            continue
        best = judged
    if best is current:
        return current
    found = best.hypothesis.effects[-1]
    state.rivals.append(
        Rival(
            own, current.cost - best.cost, current.ratio, state.round,
            f"it explains less than {found.effect} at {found.target}", pays=True,
        )
    )  # fmt: skip
    return state.renewed(state.prune(best, newest=True))


def _doubtful(state: SearchState, judged: Judged) -> bool:
    """Whether the last effect would have to be another one in other motion."""
    last = len(judged.hypothesis.effects) - 1
    return doubtful(state.bench, judged, last) is not None


def _fitted(state: SearchState, start: Hypothesis, best: Judged) -> Judged | None:
    """Fitted, to the end if it comes near the best; declared parameters start anew, as what they
    made up for has changed."""
    anew = dataclasses.replace(start, factors=tuple((one, 1.0) for one, _ in start.factors))
    judged = state.judge.judge(anew, state.iterations)
    if judged is not None and judged.cost < best.cost + _NEARLY:
        judged = state.judge.closer(judged, state.iterations)
    return judged


def _rivals(state: SearchState, current: Judged, fewer: Judged, index: int) -> list[Suspect]:
    """Suspects that a screening ranks before an effect, and some after it."""
    own, ranked = current.hypothesis.effects[index], _screened(state, fewer)
    same = [(s.instance.effect, s.instance.target) == (own.effect, own.target) for s in ranked]
    until = (same.index(True) if any(same) else 0) + 1 + _AFTER
    return [s for s, own_one in zip(ranked[:until], same, strict=False) if not own_one][:_MOST]


def _screened(state: SearchState, fewer: Judged) -> Sequence[Suspect]:
    """Suspects on top of a hypothesis."""
    bench, only = state.bench, state.settings.effects
    intervals = linearize(bench.flow(fewer.hypothesis))
    found = screen(bench, fewer.hypothesis, intervals, only, state.columns)
    return found.tuned if fewer.hypothesis.factors else found.suspects


def _better(state: SearchState, judged: Judged, best: Judged) -> bool:
    """Whether it explains more, or as much with fewer numbers; with as many, an effect that was
    found stays, unless the other comes before it in the catalogue."""
    if not tied(judged, best):
        return judged.cost < best.cost
    model = state.bench.scene.model
    return _simplicity(model, judged) < _simplicity(model, best)


def _simplicity(model: mujoco.MjModel, judged: Judged) -> tuple[int, list[int]]:
    """How many numbers the effects have, and where they stand in the catalogue."""
    names, effects = effect_names(), judged.hypothesis.effects
    return numbers(model, effects), sorted(names.index(one.effect) for one in effects)


_AFTER = 3
_NEARLY = 100.0
_MOST = 6
_SEVERAL = 3
_FIRST = 3
_IN_PARTS = "payload"
