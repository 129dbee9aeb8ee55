"""Laws without a name that do better than named effects."""

from __future__ import annotations

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import consistency, simplification
from orbisim.diagnosis.consistency import inconsistency
from orbisim.diagnosis.context import begun
from orbisim.diagnosis.explanations import Found, Tried
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.worth import worth
from orbisim.effects import EffectInstance
from orbisim.effects.unnamed import OneSidedLaw
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.stepping import stepping
from orbisim.testing import inject_effect

SPRING = EffectInstance("joint_spring", "elbow", {"stiffness": 0.3, "rest_position": 0.0})
CORD = EffectInstance(
    "law_of_one_side",
    "elbow",
    {"stiffness": 1.5, "damping": 0.02, "position": 0.1, "side": 1.0},
)


def found(arm: orbisim.Scene, truth: EffectInstance, duration: float) -> tuple[Bench, Judged, str]:
    """A spring fitted to recordings of the arm with an effect, and the law that is better."""
    runs = inject_effect(arm, truth, duration=duration, episodes=3, noise=2e-4, seed=3)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    context = begun(bench, Settings(), lambda _: None)
    judged = context.judge.judge(Hypothesis((SPRING,)), 8)
    assert judged is not None
    assert len(judged.fit.per_window) >= 2 * consistency._FEWEST  # of fewer nothing is ever told
    return (
        bench,
        judged,
        simplification.named(
            Found(context, *[stepping(context.bench.scene)] * 2, judged, judged)
        ).law,
    )


@pytest.mark.slow
def test_a_spring_is_no_name_for_a_cord_that_pulls_on_one_side(arm: orbisim.Scene) -> None:
    # over 4 s the cord pulls late only, and what is told is the time
    bench, judged, law = found(arm, CORD, duration=6.0)
    assert judged.ratio > 1.5
    assert "'elbow' alone" in law
    told = inconsistency(bench, judged, 0)
    assert told is not None and "position" in told


def test_a_spring_is_one(arm: orbisim.Scene) -> None:
    bench, judged, law = found(arm, SPRING, duration=4.0)
    assert law == ""
    assert inconsistency(bench, judged, 0) is None
    assert judged.hypothesis.effects[0].values["stiffness"] == pytest.approx(0.3, rel=0.02)


def test_what_leaves_but_noise_by_itself_keeps_its_name(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A needless second effect beside damping: what does as well as both, with fewer numbers, takes
    the names of both away, but not of damping if that was enough."""
    damping = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.08})
    monkeypatch.setattr(simplification, "laws", lambda *_: [Hypothesis((damping,))])
    runs = inject_effect(arm, damping, duration=3.0, episodes=1, noise=2e-4, seed=3)
    context = begun(make_bench(arm, prepare_all(runs, arm), 0.5), Settings(), lambda _: None)
    needless = EffectInstance("quadratic_damping", "elbow", {"coefficient": 1e-3})
    declared, alone, both = (
        context.judge.judge(Hypothesis(effects), 3)
        for effects in ((), (damping,), (damping, needless))
    )
    assert declared is not None and alone is not None and both is not None
    assert (
        "'elbow' alone"
        in simplification.named(
            Found(context, *[stepping(context.bench.scene)] * 2, declared, both)
        ).law
    )
    tried = Tried(alone, 1, worth(context.bench, declared, alone))
    kept = simplification.named(
        Found(context, *[stepping(context.bench.scene)] * 2, declared, both, tried=(tried,))
    )
    assert kept.best is alone and not kept.law


def test_a_law_of_one_side_is_fitted_from_either_side() -> None:
    begun = OneSidedLaw().beginnings(np.linspace(-1, 3, 101))
    assert sorted({one["position"] for one in begun}) == pytest.approx([0.0, 1.0, 2.0])
    assert {one["side"] for one in begun} == {-1.0, 1.0}


def test_a_scale_and_an_offset_are_no_names_for_an_eccentric_encoder(arm: orbisim.Scene) -> None:
    """Two waves a turn are none of the catalogue's; along a part of a turn a scale and an offset
    do some of what they do."""
    runs = []
    for run in inject_effect(arm, [], duration=3.0, episodes=3, noise=2e-4, seed=3):
        q = run["qpos/elbow"]
        read = q + 0.02 * np.sin(2 * q + 0.7)
        kept = {n: v for n, v in run.signals.items() if not n.startswith("qvel")}
        runs.append(run.replace(signals={**kept, "qpos/elbow": read}))
    context = begun(make_bench(arm, prepare_all(runs, arm), 0.5), Settings(), lambda _: None)
    scale = EffectInstance("sensor_scale", "elbow", {"factor": 1.0})
    offset = EffectInstance("sensor_bias", "elbow", {"offset": 0.0})
    declared = context.judge.judge(Hypothesis())
    both = context.judge.judge(Hypothesis((scale, offset)), 8)
    assert declared is not None and both is not None
    assert worth(context.bench, declared, both).sure > 0
    law = simplification.named(
        Found(context, *[stepping(context.bench.scene)] * 2, declared, both)
    ).law
    assert "smooth function of the position" in law and "'elbow' alone" in law
