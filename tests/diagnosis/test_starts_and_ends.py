"""Where fits begin, and what they may end in."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.checks import bad_windows
from orbisim.diagnosis.conclusion import concluded
from orbisim.diagnosis.context import Context, begun
from orbisim.diagnosis.explanations import Found
from orbisim.diagnosis.proposals import begin
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.suspects import Suspect
from orbisim.effects import EffectInstance
from orbisim.host.deadline import NEVER
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.stepping import stepping
from orbisim.testing import inject_effect

BIAS = EffectInstance("torque_bias", "elbow", {"offset": 0.2})
STUCK = EffectInstance(
    "load_dependent_friction", "elbow", {"coefficient": 3.0}, {"load": "external"}
)


def bench_of(arm: orbisim.Scene, *effects: EffectInstance, noise: float = 1e-4) -> Bench:
    runs = inject_effect(arm, list(effects), duration=4.0, episodes=3, noise=noise, seed=4)
    return make_bench(arm, prepare_all(runs, arm), 0.5)


def context_of(bench: Bench) -> Context:
    return begun(bench, Settings(), lambda _: None)


def test_friction_that_makes_a_joint_stick_begins_smaller() -> None:
    left = {3.0: 50.0, 1.5: 12.0, 0.75: 4.0, 0.3: 7.0, 0.0: 10.0}

    def glance(hypothesis: Hypothesis, begin: None) -> float:
        return left[hypothesis.effects[0].values["coefficient"] if hypothesis.effects else 0.0]

    def sized(size: float) -> EffectInstance:
        return dataclasses.replace(STUCK, values={"coefficient": 3.0 * size})

    judge = SimpleNamespace(glance=glance, begin=lambda judged: None)
    context: Any = SimpleNamespace(judge=judge, bench=SimpleNamespace(contacts=False))
    current: Any = SimpleNamespace(hypothesis=Hypothesis())

    def first(candidate: Suspect) -> EffectInstance:
        return begin(context, current, candidate).effects[0]

    assert first(Suspect(STUCK, sized=sized)).values["coefficient"] == 0.75
    small = sized(0.25)
    assert first(Suspect(small, sized=sized)) is small
    assert first(Suspect(STUCK)) is STUCK  # no other size is known


def test_a_long_first_step_is_shortened_until_it_helps(arm: orbisim.Scene) -> None:
    """Where a joint does not stick yet, friction seems to do little."""
    truth = dataclasses.replace(STUCK, values={"coefficient": 0.45})
    judge = context_of(bench_of(arm, truth)).judge
    nothing = judge.judge(Hypothesis())
    small = dataclasses.replace(STUCK, values={"coefficient": 0.15})
    assert nothing is not None
    found = judge.judge(Hypothesis((small,)), 8, begin=judge.begin(nothing))
    assert found is not None
    assert found.hypothesis.effects[0].values["coefficient"] == pytest.approx(0.45, rel=0.02)


def test_what_some_windows_did_not_determine_all_windows_do(arm: orbisim.Scene) -> None:
    context = context_of(bench_of(arm, BIAS))
    wrong = dataclasses.replace(BIAS, values={"offset": 0.15})
    held = Hypothesis((wrong,), frozen=frozenset({(0, "offset")}))
    declared, best = context.judge.judge(Hypothesis()), context.judge.judge(held)
    assert declared is not None and best is not None
    found = concluded(Found(context, *[stepping(context.bench.scene)] * 2, declared, best), NEVER)
    assert found.hypothesis.effects[0].values["offset"] == pytest.approx(0.2, rel=0.01)
    assert found.evidence[0] > 100 and not found.rejected


def test_what_is_bad_in_few_windows_is_said() -> None:
    declared: Any = SimpleNamespace(fitted=np.array([1.0, 36.0]), checked=np.array([0.9, 4.0]))
    assert bad_windows(declared).startswith(
        "2 of 4 windows miss by more than 1.5 times the noise (up to 6 times)"
    )
