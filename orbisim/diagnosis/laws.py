"""Whether one smooth law without a name does what takes several named effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import mujoco

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.refine import Judge, Judged
from orbisim.effects import EffectInstance, find
from orbisim.effects.base import index_of, names_of_kind
from orbisim.effects.unnamed import UNNAMED

_ITERATIONS = 8


def imitated(judge: Judge, found: Judged) -> str | None:
    """What several effects imitate, if a single law at one of their joints costs no more.

    Args:
      judge: fits hypotheses to the windows that `found` was fitted to.
      found: the explanation in question.
    """
    hypothesis = found.hypothesis
    if len(hypothesis.effects) < 2:
        return None
    model = judge.bench.scene.model
    for joint in dict.fromkeys(_joints(model, hypothesis)):
        for law in UNNAMED:
            effect = find(law.name)
            if not effect.possible(model, joint):
                continue
            still = {p.name: 0.0 for p in effect.parameters(model, joint)}
            single = EffectInstance(law.name, joint, still)
            rival = dataclasses.replace(hypothesis, effects=(single,), frozen=frozenset())
            judged = judge.judge(rival, _ITERATIONS)
            if judged is not None and judged.cost <= found.cost:
                return f"{effect.phrase}, at {joint!r} alone, explains it as well"
    return None


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
