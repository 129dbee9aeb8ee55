"""Effects with values, and what a fit changes of them."""

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance, find
from orbisim.shooting.hypothesis import Hypothesis, sized
from orbisim.shooting.retune import REACH, Tunable

DRY = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
DAMPING = EffectInstance("viscous_damping", "shoulder", {"coefficient": 0.05})
MASS = Tunable("mass", "forearm")


def test_values_are_of_free_parameters_then_of_factors(arm: orbisim.Scene) -> None:
    both = Hypothesis((DRY, DAMPING), frozenset({(0, "torque")})).tuned([MASS])
    assert both.free(arm) == [(1, "coefficient")]
    np.testing.assert_array_equal(both.values(arm), [0.05, 1.0])
    moved = both.at(arm, np.array([0.07, 1.02]))
    assert [e.values for e in moved.effects] == [{"torque": 0.1}, {"coefficient": 0.07}]
    assert moved.factors == ((MASS, 1.02),)
    names = [one.name for one in both.unknowns(arm)]
    assert names == ["viscous_damping(shoulder).coefficient", "mass of forearm"]
    assert both.unknowns(arm)[1].high == 1 + REACH


def test_without_an_effect_the_others_stay_frozen() -> None:
    both = Hypothesis((DRY, DAMPING), frozenset({(0, "torque"), (1, "coefficient")}))
    assert both.without(0) == Hypothesis((DAMPING,), frozenset({(0, "coefficient")}))


def test_a_factor_gives_way_to_the_effect_that_means_the_same() -> None:
    damping = Tunable("damping", "shoulder")
    tuned = Hypothesis().tuned([MASS, damping])
    assert tuned.plus(DAMPING).factors == ((MASS, 1.0),)
    assert Hypothesis((DAMPING,)).tuned([MASS, damping]).factors == ((MASS, 1.0),)


def test_the_scene_has_effects_and_factors(arm: orbisim.Scene) -> None:
    found = Hypothesis((DAMPING,), factors=((MASS, 1.05),)).scene(arm).model
    assert found.body("forearm").mass[0] == pytest.approx(1.05 * arm.model.body("forearm").mass[0])
    assert found.dof_damping[0] > arm.model.dof_damping[0]


def test_a_refinement_stands_beside_what_it_refines(arm: orbisim.Scene) -> None:
    values = {"coulomb": 0.2, "static": 0.5, "velocity": 0.1}
    stribeck = EffectInstance("stribeck_friction", "elbow", values)
    parts = Hypothesis((stribeck,)).in_parts()
    assert parts.effects == (
        stribeck.replace(coulomb=0.0, static=0.3),
        DRY.replace(torque=0.2),
    )
    assert parts.free(arm) == [(0, "excess"), (0, "velocity"), (1, "torque")]
    both = Hypothesis((DRY, stribeck)).in_parts()
    assert both.effects[0].values["torque"] == pytest.approx(0.3)
    assert both.effects[1].values["coulomb"] == 0.0
    assert Hypothesis((DRY,)).plus(stribeck).effects[1].values["coulomb"] == 0.0
    assert Hypothesis((stribeck,)).free(arm)[0] == (0, "coulomb")


def test_an_effect_at_another_size_stays_within_its_bounds(arm: orbisim.Scene) -> None:
    half = sized(arm, DRY, 0.5)
    assert half == DRY.replace(torque=0.05)
    assert sized(arm, DRY, 1.0) == DRY
    back = sized(arm, DRY, -1.0)  # no friction is negative
    assert back is not None and back.values["torque"] == 0.0
    stribeck = {"coulomb": 0.1, "static": 0.15, "velocity": 0.05}
    twice = sized(arm, EffectInstance("stribeck_friction", "elbow", stribeck), 2.0)
    assert twice is not None  # as large in both, from the same speed on
    assert twice.values == pytest.approx({"coulomb": 0.2, "static": 0.3, "velocity": 0.05})
    tilted = find("gravity_tilt").trials(arm.model, "world")[0]
    tilt = sized(arm, EffectInstance("gravity_tilt", "world", dict(tilted)), 20.0)
    assert tilt is not None
    twenty = np.degrees(np.arctan(20 * np.tan(np.radians(tilted["angle"]))))
    assert tilt.values["angle"] == pytest.approx(twenty)
    size = np.linalg.norm([tilt.values[axis] for axis in "xyz"])
    assert size == pytest.approx(np.linalg.norm(arm.model.opt.gravity))


def test_little_of_what_another_does_not_have(arm: orbisim.Scene) -> None:
    other = EffectInstance("viscous_damping", "shoulder", {"coefficient": 0.4})
    both = Hypothesis((DRY, other))
    little = both.little(arm, Hypothesis((DRY,)))
    assert little is not None and little.effects[0] == DRY
    assert little.effects[1].values == pytest.approx({"coefficient": 0.004})
    assert both.little(arm, both) is None
