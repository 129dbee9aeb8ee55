"""Declared parameters that would have to be further off than any is: an effect does it instead.

Factors of declared parameters can make up for an effect together: all masses and the other gains a
little up are the same as one gain a little down. What is left then is noise, and no screening finds
anything more; but one of them ends at the limit of its range.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from orbisim.diagnosis.bench import SAME
from orbisim.diagnosis.paying import far_off, strain
from orbisim.diagnosis.refine import Judged
from orbisim.diagnosis.retune import Tunable
from orbisim.diagnosis.rounds import ROUNDED
from orbisim.diagnosis.screening import bounded_instance
from orbisim.diagnosis.state import Rival, SearchState
from orbisim.effects import EffectInstance
from orbisim.effects.base import index_of


def relieved(state: SearchState, current: Judged) -> Judged | None:
    """With the effect that a declared parameter at the end of its range stands for, if no other
    parameter is at the end of its range then. No declared parameter is that far off: the effect
    need not earn the margin, it must only not cost more than that."""
    found: list[Judged] = []
    state.judge.start_from(current)
    for one in strain(current.hypothesis):
        instance = meant(state, one, dict(current.hypothesis.factors)[one])
        if instance is None or state.late:
            continue
        state.say(f"fitting {instance.effect} at {instance.target} instead of a {one.kind} far off")
        judged = state.judge.judge(current.hypothesis.plus(instance), state.iterations)
        if judged is None or strain(judged.hypothesis) or not state.done(judged):
            continue
        if judged.cost < current.cost + state.settings.margin:
            found.append(judged)
    return _first_of(state, found) if found else None


def gathered(state: SearchState, tuned: Judged) -> Judged:
    """One gain far off instead of several declared parameters a little off, if that is better: a
    motor a tenth too weak is shared out among its gain, masses and dampings.

    Args:
      tuned: an explanation in which declared parameters are retuned.
    """
    factors = dict(tuned.hypothesis.factors)
    far = [one for one, factor in factors.items() if abs(factor - 1) > _A_LITTLE]
    gains = sorted((one for one in far if one.kind == "gain"), key=lambda o: -abs(factors[o] - 1))
    found: list[Judged] = []
    for one in gains[:_FEW] if len(far) > 1 else ():
        instance = meant(state, one, factors[one])
        if instance is None or state.late:
            continue
        state.say(f"fitting {instance.effect} at {instance.target} instead of several parameters")
        start = tuned.hypothesis.plus(instance)
        anew = tuple((other, 1.0) for other, _ in start.factors)
        state.judge.start_from(tuned)
        judged = state.judge.judge(dataclasses.replace(start, factors=anew), state.iterations)
        if judged is None or strain(judged.hypothesis) or not state.done(judged):
            continue
        gain = judged.hypothesis.effects[-1].values["gain"]
        if far_off(gain) and judged.cost < tuned.cost - ROUNDED:
            found.append(judged)
    state.judge.start_from(tuned)
    return _first_of(state, found) if found else tuned


def _first_of(state: SearchState, found: list[Judged]) -> Judged:
    """The best; all are kept as rivals of one round."""
    state.round += 1
    found.sort(key=lambda judged: judged.cost)
    for judged in found:
        last, best = judged.hypothesis.effects[-1], found[0].hypothesis.effects[-1]
        reason = f"it explains less than {best.effect} at {best.target}" if last != best else ""
        behind = judged.cost - found[0].cost
        state.rivals.append(Rival(last, behind, judged.ratio, state.round, reason, pays=True))
    return found[0]


_A_LITTLE = 0.015
"""Deviation from 1 of a factor that may be part of what an effect does."""
_FEW = 3


def meant(state: SearchState, one: Tunable, factor: float) -> EffectInstance | None:
    """The effect that does the same as a declared parameter times a factor; None if there is none
    (less friction than declared, say). Of a mass, it is a point at its centre."""
    names = [name for name, kind in SAME.items() if kind == one.kind]
    if not names or one.kind == "stiffness":  # a joint has one spring
        return None
    only = state.settings.effects
    if only is not None and names[0] not in only:
        return None
    if factor < 1 and one.kind in ("frictionloss", "armature"):  # there is no negative friction
        return None
    values = _values(state, one, factor)
    return bounded_instance(state.bench.scene, EffectInstance(names[0], one.target, dict(values)))


def _values(state: SearchState, one: Tunable, factor: float) -> Mapping[str, float]:
    model, more = state.bench.scene.model, factor - 1.0
    if one.kind == "gain":
        return {"gain": factor}
    if one.kind == "mass":
        body = index_of(model, "body", one.target)
        place = zip(("com_x", "com_y", "com_z"), map(float, model.body_ipos[body]), strict=True)
        return {"mass": more * float(model.body_mass[body]), **dict(place)}
    joint = index_of(model, "joint", one.target)
    dof = int(model.jnt_dofadr[joint])
    if one.kind == "damping":
        return {"coefficient": more * float(model.dof_damping[dof])}
    if one.kind == "frictionloss":
        return {"torque": more * float(model.dof_frictionloss[dof])}
    return {"inertia": more * float(model.dof_armature[dof])}
