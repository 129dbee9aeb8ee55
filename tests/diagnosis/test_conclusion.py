"""What the report says of explanations that were fitted and not taken."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import conclusion
from orbisim.diagnosis.conclusion import concluded, rivals_of
from orbisim.diagnosis.context import begun
from orbisim.diagnosis.explanations import Found, Tried
from orbisim.diagnosis.findings import effects_of
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.wording import described, interval
from orbisim.effects import EffectInstance
from orbisim.evidence import Gain
from orbisim.host.deadline import NEVER
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge
from orbisim.shooting.stepping import stepping
from orbisim.testing import inject_effect


def tried(name: str, gain: float, number: int, reason: str = "") -> Tried:
    hypothesis = Hypothesis((EffectInstance(name, "elbow", {}),) if name else ())
    judged: Any = SimpleNamespace(hypothesis=hypothesis, ratio=2.0)
    return Tried(judged, number, Gain(gain, 1.0, -3.0), reason)


def test_rivals_are_behind_the_best_of_their_round() -> None:
    """By twice the logarithm of the odds; retuned parameters alone are no rival."""
    first = tried("cogging", 50.0, 1), tried("armature", 20.0, 1, "it explains less than cogging")
    again = tried("armature", 10.0, 1, "it explains less")
    found = rivals_of([again, *first, tried("", 60.0, 1), tried("backlash", 5.0, 2)])
    behind = {one.instance.effect: one.delta_bic for one in found}
    assert behind == pytest.approx({"cogging": 20.0, "armature": 80.0, "backlash": 0.0})
    assert [one.reason for one in found] == ["", "it explains less than cogging", ""]
    assert [one.round for one in found] == [1, 1, 2]


PLACE = {"com_x": 0.0, "com_y": 0.0, "com_z": -0.05}
LOAD = EffectInstance("payload", "forearm", {"mass": 0.2, **PLACE})


def test_a_number_that_was_not_fitted_has_no_interval(arm: orbisim.Scene) -> None:
    """It is held at its value, about which the data say nothing."""
    runs = inject_effect(arm, [LOAD], duration=2.0, episodes=2, noise=2e-4, seed=3)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    held = Hypothesis((LOAD,), frozen=frozenset({(0, "com_z")}))
    judged = Judge(bench, bench.intervals).judge(held)
    assert judged is not None
    (found,) = effects_of(arm, judged.hypothesis, judged.fit, [1.0], lambda _: 0.0, 0)
    mass, height = found.parameters["mass"], found.parameters["com_z"]
    assert mass.ci95[0] < mass.value < mass.ci95[1]
    assert height.value == -0.05 and np.isnan(height.ci95).all()
    assert interval(*height.ci95) == "not determined"
    only = dataclasses.replace(found, parameters={"com_z": height})
    assert "com_z -0.05 m" in described(only) and "nan" not in described(only)


def test_the_size_of_a_vector_has_no_interval_where_a_component_has_none(
    arm: orbisim.Scene,
) -> None:
    """An arm in a plane does not feel a force across it."""
    push = EffectInstance("constant_force", "forearm", {"magnitude": 5.0, "x": 3.0, "y": 0, "z": 4})
    runs = inject_effect(arm, [push], duration=2.0, episodes=2, noise=2e-4, seed=3)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    for frozen in (frozenset({(0, "y")}), frozenset[tuple[int, str]]()):
        judged = Judge(bench, bench.intervals).judge(Hypothesis((push,), frozen=frozen))
        assert judged is not None
        (found,) = effects_of(arm, judged.hypothesis, judged.fit, [1.0], lambda _: 0.0, 0)
        size, one = found.parameters["magnitude"], found.parameters["x"]
        assert one.ci95[0] < 3.0 < one.ci95[1] and size.value == pytest.approx(5.0, rel=0.05)
        assert np.isnan(size.ci95).all() == bool(judged.hypothesis.frozen)


@pytest.mark.parametrize("noise", [True, False])
def test_effects_go_where_noise_that_lasts_is_all(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch, noise: bool
) -> None:
    """And stay where it is not."""
    runs = inject_effect(arm, [LOAD], duration=2.0, episodes=2, noise=2e-4, seed=3)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    context = begun(bench, Settings(effects=("payload",)), lambda _: None)
    declared, best = (context.judge.judge(Hypothesis(some)) for some in ((), (LOAD,)))
    assert declared is not None and best is not None
    left: Any = SimpleNamespace(structured=False, data=SimpleNamespace(y=np.zeros((2, 9, 4))))
    odds: list[float] = []

    def bare_is_noise(*args: Any) -> Any:
        odds.append(args[-1])
        return left if noise else None

    monkeypatch.setattr(conclusion, "left_of", lambda *_: left)
    monkeypatch.setattr(conclusion, "bare_is_noise", bare_is_noise)
    found = concluded(Found(context, *[stepping(arm)] * 2, declared, best), NEVER)
    assert odds[0] < 0  # what the load's numbers cost
    assert bool(found.hypothesis.effects) == (not noise)
    reasons = [why for effect, why in found.rejected if effect.effect == "payload"]
    assert any("noise that lasts" in why for why in reasons) == noise
    if noise:
        assert found.after is found.before and found.left is left and not found.evidence
