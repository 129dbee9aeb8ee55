"""A better effect in the place of one that was found while others were missing."""

from __future__ import annotations

import orbisim
from orbisim.diagnosis.bench import Hypothesis, make_bench
from orbisim.diagnosis.rounds import simpler
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import SearchState
from orbisim.diagnosis.swapping import swapped
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

DAMPING = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.05})
BIAS = EffectInstance("torque_bias", "elbow", {"offset": 0.2})
SOFT = EffectInstance("joint_spring", "elbow", {"stiffness": 2e-3, "rest_position": 100.0})
STRIBECK = EffectInstance(
    "stribeck_friction", "elbow", {"coulomb": 0.1, "static": 0.1, "velocity": 0.1}
)
COULOMB = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})


def searched(arm: orbisim.Scene) -> SearchState:
    runs = inject_effect(arm, [DAMPING, BIAS], duration=4.0, episodes=3, noise=1e-4, seed=4)
    return SearchState(make_bench(arm, prepare_all(runs, arm), 0.5), Settings(), lambda _: None)


def test_a_spring_that_only_pushes_gives_way_to_an_offset(arm: orbisim.Scene) -> None:
    state = searched(arm)
    before = state.need(Hypothesis((SOFT, DAMPING)))
    after = swapped(state, before)
    assert {e.effect for e in after.hypothesis.effects} == {"viscous_damping", "torque_bias"}
    offset = next(e for e in after.hypothesis.effects if e.effect == "torque_bias")
    assert abs(offset.values["offset"] - 0.2) < 0.01
    told = [r for r in state.rivals if r.instance.effect == "joint_spring"]
    assert "torque_bias at elbow" in told[-1].reason


def test_one_effect_alone_and_the_right_ones_stay(arm: orbisim.Scene) -> None:
    state = searched(arm)
    single = state.need(Hypothesis((BIAS,)))
    assert swapped(state, single) is single
    right = state.need(Hypothesis((BIAS, DAMPING)))
    assert swapped(state, right) is right


def test_of_equals_the_one_with_fewest_numbers_then_the_first_in_the_catalogue(
    arm: orbisim.Scene,
) -> None:
    ranked = sorted(
        (Hypothesis((STRIBECK,)), Hypothesis((BIAS,)), Hypothesis((COULOMB,))),
        key=lambda hypothesis: simpler(arm.model, hypothesis),
    )
    assert [h.effects[0].effect for h in ranked][-1] == "stribeck_friction"
    assert ranked[0].effects[0].effect == "coulomb_friction"
