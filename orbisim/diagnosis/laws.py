"""Whether a law without a name does what takes several named effects, or does it better."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import mujoco
import numpy as np

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.refine import Judge, Judged
from orbisim.diagnosis.state import NEAR
from orbisim.diagnosis.worth import worth
from orbisim.effects import EffectInstance, find
from orbisim.effects.base import index_of, names_of_kind
from orbisim.effects.unnamed import UNNAMED, Law, OneSidedLaw, PositionLaw

_ITERATIONS = 8
_GLANCED = 2
"""Steps of a fit after which the best beginning is chosen."""
_BETTER = 0.5
"""Share of what an effect leaves that a law may leave at most, to take its place."""
_BENT: dict[str, tuple[type[Law], ...]] = {"joint_spring": (PositionLaw, OneSidedLaw)}
"""Laws of which an effect is the straight case."""


def imitated(judge: Judge, found: Judged, margin: float) -> str | None:
    """What effects imitate: several, if a single law at one of their joints costs no more; one that
    leaves more than noise, if a law of which it is the straight case leaves half of that.

    Args:
      judge: fits hypotheses to the windows that `found` was fitted to.
      found: the explanation in question.
      margin: of the criterion, by which a law must be better than a single effect.
    """
    hypothesis = found.hypothesis
    model = judge.bench.scene.model
    if len(hypothesis.effects) >= 2:
        for joint in dict.fromkeys(_joints(model, hypothesis)):
            for law in UNNAMED:
                judged = _judged(judge, hypothesis, law, joint)
                if judged is not None and _as_good(model, judged, found):
                    return f"{law.phrase}, at {joint!r} alone, explains it as well"
    elif hypothesis.effects and found.ratio > NEAR:
        own = hypothesis.effects[0]
        for law in _BENT.get(own.effect, ()):
            judged = _judged(judge, hypothesis, law, own.target)
            if judged is None or judged.cost > found.cost - margin:
                continue
            if judged.ratio**2 - 1 <= _BETTER * (found.ratio**2 - 1):
                return f"{law.phrase} explains it much better"
    return None


def _as_good(model: mujoco.MjModel, law: Judged, found: Judged) -> bool:
    """Whether a law does what effects do: at no higher cost where these reach the noise; where
    model error is left with either, if it surely predicts better."""
    if found.ratio <= NEAR:
        return law.cost <= found.cost
    return worth(model, found, law).sure > 0


def _judged(judge: Judge, hypothesis: Hypothesis, law: type[Law], joint: str) -> Judged | None:
    """The hypothesis with a law at a joint instead of its effects, fitted; None if that fails."""
    model = judge.bench.scene.model
    effect = law()
    if not effect.possible(model, joint):
        return None
    dof = int(model.jnt_dofadr[index_of(model, "joint", joint)])
    q = np.concatenate([one.absolute[one.usable, dof] for one in judge.bench.samples])
    begun = [
        dataclasses.replace(
            hypothesis, effects=(EffectInstance(law.name, joint, values),), frozen=frozenset()
        )
        for values in effect.beginnings(q)
    ]
    if len(begun) > 1:
        tried = [one for start in begun if (one := judge.judge(start, _GLANCED)) is not None]
        if not tried:
            return None
        begun = [min(tried, key=lambda one: one.cost).hypothesis]
    return judge.judge(begun[0], _ITERATIONS)


def _joints(model: mujoco.MjModel, hypothesis: Hypothesis) -> Iterator[str]:
    """Names of the joints at which effects act."""
    for instance in hypothesis.effects:
        kind = find(instance.effect).kind
        if kind == "joint":
            yield instance.target
        elif kind == "actuator":
            actuator = index_of(model, "actuator", instance.target)
            if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
                yield names_of_kind(model, "joint")[model.actuator_trnid[actuator, 0]]
