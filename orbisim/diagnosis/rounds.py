"""One round of the search: the effect that explains most of what is left, if any pays."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Hypothesis, clean
from orbisim.diagnosis.confidence import confidence
from orbisim.diagnosis.consistency import absurd
from orbisim.diagnosis.glances import Candidate, generalizations, shortlist
from orbisim.diagnosis.paying import few_bad, settles, unpaid
from orbisim.diagnosis.refine import Judged, is_structural
from orbisim.diagnosis.screening import cleaned
from orbisim.diagnosis.state import NEAR, Rival, SearchState
from orbisim.diagnosis.suspects import Screening, Suspect
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.effects.base import index_of
from orbisim.errors import OrbiSimError


def best_addition(
    state: SearchState, current: Judged, suspects: Sequence[Suspect], screening: Screening
) -> Judged | None:
    """The best effect to add, if any pays."""
    found = _suspects(state, current, suspects, screening)
    return _best_of(state, current, found, current.hypothesis.plus)


def best_with_retuning(
    state: SearchState,
    tuned: Judged,
    screening: Screening,
    only: Sequence[EffectInstance] | None = None,
) -> Judged | None:
    """The best single effect where declared parameters are retuned with it, if any pays.

    Args:
      tuned: the declared parameters retuned, without effects. screening: of the declared scene.
      only: the effects to try; if None the best of the first round and of the screening.
    """
    if only is None:
        alone = sorted((r for r in state.rivals if r.round == 1), key=lambda r: r.delta_bic)
        found = [r.instance for r in alone[:_FEW]]
        found += [e for s in screening.tuned if (e := cleaned(state.bench, s)) is not None]
        only = found[: _FEW + state.settings.shortlist]
    first = {(e.effect, e.target): e for e in reversed(only)}
    candidates = [Candidate(e) for e in reversed(first.values())]
    state.renew(Hypothesis())
    return _best_of(state, tuned, candidates, lambda e: Hypothesis((e,)).tuned(state.tunables))


def _best_of(
    state: SearchState,
    current: Judged,
    candidates: Iterable[Candidate],
    plus: Callable[[EffectInstance], Hypothesis],
) -> Judged | None:
    """The best of some effects, if any pays.

    Args:
      candidates: the most promising first. plus: the hypothesis with one.
    """
    state.round += 1
    state.judge.start_from(current)
    fitted: list[Judged] = []
    begun: list[EffectInstance] = []
    for candidate in candidates:
        if fitted and (state.late or _settled(current, fitted, candidate.slow)):
            break
        instance = _tamed(state, plus, candidate)
        state.say(f"round {state.round}: fitting {instance.effect} at {instance.target}")
        quick = state.bench.contacts  # the best few are fitted again
        start = begin(state, plus(instance), candidate.moved)
        judged = state.judge.judge(start, state.iterations, polish=not quick)
        if judged is not None:
            fitted.append(judged)
            begun.append(instance)
        else:
            state.rejected.append((instance, "the scene with it cannot be simulated"))
    model = state.bench.scene.model
    fitted += generalized(state, fitted, plus, begun)
    if not fitted:
        return None
    few = _closer(state, distinct(ranked(model, fitted, current)))
    fitted = ranked(model, few, current)
    unpaying = [unpaid(state.settings, current, judged) for judged in fitted]
    winner, reasons = _winner(state, fitted, unpaying)
    state.rivals += [
        Rival(
            j.hypothesis.effects[-1], j.cost - fitted[0].cost, j.ratio, state.round, reason,
            pays=problem is None,
        )
        for j, reason, problem in zip(fitted, reasons, unpaying, strict=True)
    ]  # fmt: skip
    return winner


def _tamed(
    state: SearchState, plus: Callable[[EffectInstance], Hypothesis], candidate: Candidate
) -> EffectInstance:
    """An effect smaller than suspected where that leaves more than there is without it: with more
    friction than the true one a joint sticks, and a fit does not find back. Where bodies touch, the
    shortlist has seen to it."""
    instance = candidate.instance
    if state.bench.contacts or find(instance.effect).structural:
        return instance
    whole = plus(instance)
    most = state.judge.glance(whole.without(len(whole.effects) - 1))
    if state.judge.glance(whole) <= most:
        return instance
    smaller = (one for share in _SMALLER if (one := candidate.sized(share)) is not None)
    return next((one for one in smaller if state.judge.glance(plus(one)) < most), instance)


def generalized(
    state: SearchState,
    fitted: Sequence[Judged],
    plus: Callable[[EffectInstance], Hypothesis],
    begun: Sequence[EffectInstance],
) -> list[Judged]:
    """Effects that do worse than a special case of them, or were not tried although one is among
    the best, fitted again from there."""
    model, found = state.bench.scene.model, []
    for general, own in zip(fitted, begun, strict=True):
        for special in fitted:
            other = special.hypothesis.effects[-1]
            if special.cost >= general.cost or other.target != own.target:
                continue
            forms = find(own.effect).generalized(model, other, own.values)
            starts = [plus(dataclasses.replace(own, values=dict(values))) for values in forms]
            if starts:
                start = min(starts, key=state.judge.glance)
                found.append(state.judge.judge(start, state.iterations))
    best = sorted(fitted, key=lambda judged: judged.cost)[:_FEW]
    done = bool(best) and state.done(best[0])
    tried = {(one.effect, one.target) for one in begun}
    for special in best[:1] if done else best:
        own = special.hypothesis.effects[-1]
        every = generalizations(state, own)
        if done:  # what explains all gives way only to what needs fewer numbers
            every = [one for one in every if numbers(model, [one]) < numbers(model, [own])]
        more = [one for one in every if (one.effect, one.target) not in tried]
        tried.update((one.effect, one.target) for one in more)
        for _, same in itertools.groupby(more, key=lambda one: one.effect):
            start = min(map(plus, same), key=state.judge.glance)
            found.append(state.judge.judge(start, state.iterations))
    return [judged for judged in found if judged is not None]


def begin(
    state: SearchState, hypothesis: Hypothesis, moved: npt.NDArray[np.float64] | None
) -> Hypothesis:
    """Where a fit begins: the effects before as they are or, if that leaves less, moved."""
    other = _moved(state, hypothesis, moved)
    if other is hypothesis or is_structural(hypothesis):
        return hypothesis
    return min((hypothesis, other), key=state.judge.glance)


def _moved(
    state: SearchState, hypothesis: Hypothesis, moved: npt.NDArray[np.float64] | None
) -> Hypothesis:
    """With other values of the first parameters."""
    if moved is None or not moved.any():
        return hypothesis
    values = hypothesis.values(state.bench.scene)
    values[: len(moved)] += moved
    return hypothesis.at(state.bench.scene, values)


def distinct(ranked: Sequence[Judged]) -> list[Judged]:
    """The better of two fits of the same effect."""
    first: dict[tuple[str, str, str], Judged] = {}
    for judged in ranked:
        last = judged.hypothesis.effects[-1]
        first.setdefault((last.effect, last.target, str(sorted(last.options.items()))), judged)
    return list(first.values())


def _closer(state: SearchState, fitted: Sequence[Judged]) -> list[Judged]:
    """The same with the best few fitted to the end; where bodies touch and fits are slow, only if
    it is not clear which is best."""
    few = fitted[:_FEW]
    if state.bench.contacts:
        few = [judged for judged in few if judged.cost < fitted[0].cost + _NEARLY]
        few = few if len(few) > 1 else []
    return [*(state.judge.closer(one, state.iterations) for one in few), *fitted[len(few) :]]


def _winner(
    state: SearchState, fitted: Sequence[Judged], unpaying: Sequence[str | None]
) -> tuple[Judged | None, list[str]]:
    """The first of the best that pays, and why each of the others was not taken.

    Args:
      unpaying: why each does not pay, if it does not.
    """
    winner: Judged | None = None
    reasons: list[str] = []
    for place, (judged, reason) in enumerate(zip(fitted, unpaying, strict=True)):
        last = len(judged.hypothesis.effects) - 1
        reason = reason or hollowed(state, judged)
        if reason is None and winner is not None:
            best = winner.hypothesis.effects[-1]
            reason = f"it explains less than {best.effect} at {best.target}"
        elif reason is None and place >= 3:
            reason = "it explains less than three others, none of which was believed"
        elif reason is None and judged.ratio > NEAR:
            reason = absurd(
                state.bench.scene.model, judged.hypothesis.effects[last], state.bench.samples
            )
            if reason is not None:
                state.rejected.append((judged.hypothesis.effects[-1], reason))
        if reason is None:
            winner = judged
        reasons.append(reason or "")
    return winner, reasons


def hollowed(state: SearchState, judged: Judged) -> str | None:
    """Why the last effect is really another one with fewer numbers, or none; None if it is not."""
    last = judged.hypothesis.effects[-1]
    if find(last.effect).family == "friction":
        problem = absurd(state.bench.scene.model, last, state.bench.samples)
        if problem is not None:
            return problem
    return vague(state, judged)


def vague(state: SearchState, judged: Judged) -> str | None:
    """Why a stiffness is not one; None if it is. That of a spring may be zero, far from where it is
    at rest: a constant force. That of a transmission may be infinite: it is rigid, and what it made
    better were windows' starts."""
    effects = judged.hypothesis.effects
    last = len(effects) - 1
    if effects[last].effect not in _STIFF or state.bench.contacts:
        return None
    names = [f"{i} {name}" for i, name in judged.hypothesis.free(state.bench.scene)]
    low, high = confidence(judged.fit, names).get(f"{last} stiffness", (1.0, 1.0))
    middle, width = effects[last].values["stiffness"], (high - low) / 2
    if abs(middle) > width:
        return None
    what = _STIFF[effects[last].effect]
    return f"its stiffness is {middle:.3g} +- {width:.2g}, so that it may be {what}"


def _settled(current: Judged, fitted: Sequence[Judged], slow: bool) -> bool:
    """Whether an explanation down to the noise makes clearly worse suspects idle, or one that
    leaves little those that are slow to fit. Where bodies touch, the order of suspects says less.
    """
    best = min(fitted, key=lambda j: j.cost)
    if len(fitted) < 2:
        return False
    if slow and best.ratio**2 - 1 < _LITTLE * (current.ratio**2 - 1):
        return True
    little = best.pooled**2 - 1 < _HALF * (current.pooled**2 - 1)
    return best.ratio <= 1.15 and little and (slow or (len(fitted) >= 3 and not best.touching))


def _suspects(
    state: SearchState, current: Judged, suspects: Sequence[Suspect], screening: Screening
) -> Iterator[Candidate]:
    """Best first; then stops, play and elasticity, which no regression sees."""
    hypothesis = current.hypothesis
    if is_structural(hypothesis):
        yield from _earlier(state, hypothesis)
    yield from shortlist(state, hypothesis, suspects)
    if not state.bench.contacts or few_bad(current):
        yield from (Candidate(one) for one in stops(state, hypothesis, screening.shares))
    yield from (Candidate(one, slow=True) for one in _structural(state, hypothesis, screening))


def _earlier(state: SearchState, hypothesis: Hypothesis) -> Iterator[Candidate]:
    """The best of the first round: an added joint, whose state nothing reads, hides what else is
    missing from a regression, and the first round saw it."""
    taken = {(e.effect, e.target) for e in hypothesis.effects}
    first = [rival for rival in state.rivals if rival.round == 1]
    kept = 0
    for rival in sorted(first, key=lambda rival: rival.delta_bic):
        own = rival.instance
        if (own.effect, own.target) in taken or find(own.effect).structural or kept == _FEW:
            continue
        taken.add((own.effect, own.target))
        kept += 1
        yield Candidate(own)


def _structural(
    state: SearchState, hypothesis: Hypothesis, screening: Screening
) -> Iterator[EffectInstance]:
    """Play and elasticity at the joints where something is left."""
    model = state.bench.scene.model
    names = [n for n in effect_names() if find(n).structural and find(n).kind == "joint"]
    if state.settings.effects is not None:
        names = [n for n in names if n in state.settings.effects]
    taken = {(e.effect, e.target) for e in hypothesis.effects}
    for name in names:
        for target in find(name).targets(model):
            dof = int(model.jnt_dofadr[index_of(model, "joint", target)])
            if screening.shares[dof] < _SHARE or (name, target) in taken:
                continue
            best = _best_trial(state, hypothesis, name, target)
            if best is not None:
                yield best


def stops(
    state: SearchState, hypothesis: Hypothesis, shares: npt.NDArray[np.float64]
) -> Iterator[EffectInstance]:
    """Stops near both ends of the travel of joints at which something is left: an impact is over
    within a sample or two, and smoothing hides it from a regression."""
    only, model = state.settings.effects, state.bench.scene.model
    if only is not None and _STOP not in only:
        return
    glance = state.judge.glance_at_all if state.bench.contacts else state.judge.glance
    most = glance(hypothesis) if state.bench.contacts else 0.0
    taken = {(e.effect, e.target) for e in hypothesis.effects}
    for target in find(_STOP).targets(model):
        dof = int(model.jnt_dofadr[index_of(model, "joint", target)])
        if shares[dof] < _SHARE or (_STOP, target) in taken:
            continue
        every = [one.absolute[one.usable, dof] for one in state.bench.samples]
        travel = float(np.ptp(np.concatenate(every)))
        for side in (1.0, -1.0):
            ends = _turns([side * q for q in every], _DEPTHS[1] * travel)
            places = [side * (end - depth * travel) for end in ends for depth in _DEPTHS]
            made = [EffectInstance(_STOP, target, {"position": p, "side": side}) for p in places]
            left = [glance(hypothesis.plus(one)) for one in made]
            if state.bench.contacts and not min(left) < most:
                continue
            most_left = _ALIKE * min(left)
            best = [one for one, here in zip(made, left, strict=True) if here <= most_left]
            if len(best) > 1 and not state.bench.contacts:  # no fitted window feels them
                best.sort(key=lambda one: _checked(state, hypothesis.plus(one)))
            yield best[0]


def _turns(every: Sequence[npt.NDArray[np.float64]], apart: float) -> list[float]:
    """Where motion ends: its farthest place, and the farthest at which each recording turns back. A
    recording may begin beyond a stop.

    Args:
      every: positions of each recording, growing towards the stop.
      apart: what counts as another place.
    """
    found = [max(float(q.max()) for q in every)]
    for q in every:
        inner = q[1:-1][(q[1:-1] >= q[:-2]) & (q[1:-1] >= q[2:])]
        if len(inner):
            found.append(float(inner.max()))
    kept: list[float] = []
    for end in sorted(found, reverse=True):
        if all(abs(end - other) > apart for other in kept):
            kept.append(end)
    return kept[:_ENDS]


def _checked(state: SearchState, hypothesis: Hypothesis) -> float:
    """What check windows leave, without fitting; infinite if it cannot be simulated."""
    try:
        return state.judge.score(hypothesis, state.judge.check, 2).square
    except OrbiSimError:
        return np.inf


def _best_trial(
    state: SearchState, hypothesis: Hypothesis, name: str, target: str
) -> EffectInstance | None:
    """The trial values that leave least, without fitting."""
    best, least = None, np.inf
    for values in find(name).trials(state.bench.scene.model, target):
        instance = EffectInstance(name, target, dict(values))
        try:
            instance = clean(state.bench.scene, instance)
        except OrbiSimError:  # a variant that cannot be is no candidate
            continue
        left = _checked(state, hypothesis.plus(instance))
        if left < least:
            best, least = instance, left
    return best


def tied(one: Judged, other: Judged) -> bool:
    """Whether the data do not tell two hypotheses apart."""
    return abs(one.cost - other.cost) < TIE


def numbers(model: mujoco.MjModel, effects: Iterable[EffectInstance]) -> int:
    """How many free parameters effects have; those that the data do not determine count too."""
    return sum(len(find(one.effect).free_parameters(model, one.target)) for one in effects)


def ranked(model: mujoco.MjModel, fitted: Sequence[Judged], current: Judged) -> list[Judged]:
    """Best first, and before all a stop that settles what is bad in `current`.

    Of those that the data do not tell apart, the one with the fewest numbers, then the better one,
    as the true one more often is; and of those that cost the same to `ROUNDED`, being the same
    physics, the first in the catalogue.
    """
    order = {name: i for i, name in enumerate(effect_names())}
    least = min(judged.cost for judged in fitted)

    def rank(judged: Judged) -> tuple[bool, float, int, int, int]:
        last = judged.hypothesis.effects[-1]
        size = numbers(model, [last])
        behind = round((judged.cost - least) / ROUNDED)
        cost = least if judged.cost < least + TIE else judged.cost
        return not settles(current, judged), cost, size, behind, order[last.effect]

    return sorted(fitted, key=rank)


TIE = 4.0
"""Difference in the criterion up to which data do not tell two hypotheses apart."""
ROUNDED = 0.05
"""Difference in the criterion that is a matter of how far fits went."""
_STIFF = {"joint_spring": "a constant force", "joint_flexibility": "rigid"}
_SMALLER = (0.5, 0.25, 0.1)
_FEW = 3
_NEARLY = 25.0
_SHARE = 0.08
_STOP = "hard_stop"
_ENDS = 4
_ALIKE = 1 + 1e-6
"""How many times the least a stop leaves that none of the fitted windows feels either."""
_DEPTHS = (0.0, 0.003, 0.01, 0.03, 0.08)
"""How far motion may press into a stop, in units of the travel."""
_LITTLE = 0.1
_HALF = 0.5
