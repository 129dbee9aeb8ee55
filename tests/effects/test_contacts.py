"""Effects at contacts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from orbisim import load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.effects.contacts import damping_ratio_for, restitution_of
from orbisim.errors import InputError

BOUNCE = """
<mujoco><option timestep="0.0005"/><worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
  <body name="ball" pos="0 0 0.55"><freejoint/>
    <geom name="ball" type="sphere" size="0.05" mass="0.1"/></body>
</worldbody></mujoco>
"""


@pytest.mark.parametrize("coefficient", [0.3, 0.6, 0.9])
def test_restitution_is_realised(coefficient: float) -> None:
    values = {"coefficient": coefficient, "stiffness": 2e5}
    changed = add_effects(load_scene(BOUNCE), [EffectInstance("restitution", "ball", values)])
    engine = make_backend("mujoco", changed)
    trajectory = engine.rollout(engine.reset(), np.zeros((1400, 0)))
    speed = trajectory.qvel[0, :, 2]
    assert speed.max() / -speed.min() == pytest.approx(coefficient, abs=0.05)


SLOPE = """
<mujoco><option timestep="0.001" gravity="3 0 -9" cone="elliptic" impratio="10"/><worldbody>
  <geom name="floor" type="plane" size="50 50 0.1"/>
  <body name="box" pos="0 0 0.05"><freejoint/>
    <geom name="box" type="box" size="0.1 0.1 0.05" mass="1"/></body>
</worldbody></mujoco>
"""


def test_sliding_friction() -> None:
    values = {"coefficient": 0.2}
    changed = add_effects(load_scene(SLOPE), [EffectInstance("sliding_friction", "box", values)])
    engine = make_backend("mujoco", changed)
    state = engine.step(engine.reset(), None, 1000)
    assert state.qvel[0, 0] == pytest.approx(3 - 0.2 * 9, rel=0.03)


def test_anisotropic_friction() -> None:
    values = {"ratio": 4.0, "coefficient": 0.1}
    changed = add_effects(
        load_scene(SLOPE), [EffectInstance("anisotropic_friction", "box", values)]
    )
    np.testing.assert_allclose(changed.model.pair_friction[0, :2], [0.1, 0.4])


def test_adhesion() -> None:
    """It presses the sliding box on, at each of up to four contacts: more friction."""
    slides = EffectInstance("sliding_friction", "box", {"coefficient": 0.2})
    accelerations = []
    for force in (0.0, 1.0):
        held = EffectInstance("adhesion", "box", {"force": force})
        engine = make_backend("mujoco", add_effects(load_scene(SLOPE), [slides, held]))
        start = engine.step(engine.reset(), None, 300)
        accelerations.append(
            float(engine.step(start, None, 500).qvel[0, 0] - start.qvel[0, 0]) / 0.5
        )
    assert accelerations[0] == pytest.approx(3 - 0.2 * 9, abs=0.01)
    assert 0.2 * 2 < accelerations[0] - accelerations[1] < 0.2 * 4 + 0.01


def _bounced(ratio: float) -> float:
    """Speed after over before of x" = -2 ratio x' - x, until the force is back at zero."""

    def force(t: float, x: np.ndarray) -> float:
        return float(-2 * ratio * x[1] - x[0])

    def released(t: float, x: np.ndarray) -> float:
        return force(t, x) if t > 1e-3 else -1.0

    released.terminal = True  # type: ignore[attr-defined]
    found = solve_ivp(
        lambda t, x: [x[1], force(t, x)], (0, 400), [0.0, 1.0],
        events=released, rtol=1e-9, atol=1e-12, max_step=0.1,
    )  # fmt: skip
    return float(-found.y[1, -1])


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.3, 0.7, 0.95, 1.0, 1.5])
def test_restitution_is_that_of_a_spring_and_a_damper_that_cannot_pull(ratio: float) -> None:
    assert restitution_of(ratio) == pytest.approx(_bounced(ratio), abs=2e-4)


def test_known_values_of_restitution() -> None:
    assert restitution_of(0.0) == 1.0
    assert restitution_of(1.0) == pytest.approx(np.exp(-2))
    assert restitution_of(-0.05) > 1.0


@given(st.floats(0.01, 1.3))
def test_damping_ratios_there_and_back(coefficient: float) -> None:
    assert restitution_of(damping_ratio_for(coefficient)) == pytest.approx(coefficient, rel=1e-6)


def test_damping_ratios_end_somewhere() -> None:
    assert damping_ratio_for(5.0) == -0.1
    assert damping_ratio_for(0.0) == 50.0


def test_softness_is_written_as_stiffness_and_damping() -> None:
    soft = EffectInstance("contact_compliance", "box", {"stiffness": 400.0, "damping_ratio": 0.5})
    model = add_effects(load_scene(SLOPE), [soft]).model
    np.testing.assert_allclose(model.geom("box").solref, [-400, -20])
    assert model.geom("box").priority[0] > model.geom("floor").priority[0]


def test_what_is_softer_may_bounce_otherwise_too() -> None:
    model = load_scene(SLOPE).model
    soft = EffectInstance("contact_compliance", "box", {"stiffness": 400.0, "damping_ratio": 1.0})
    assert find("contact_compliance").free_parameters(model, "box") == ("stiffness",)
    found = find("restitution").generalized(model, soft)
    assert [one["stiffness"] for one in found] == [400.0, 400.0]
    assert all(one["coefficient"] >= restitution_of(1.0) for one in found)
    other = EffectInstance("sliding_friction", "box", {"coefficient": 0.3})
    assert find("restitution").generalized(model, other) == []


SLIDE = """
<mujoco><option timestep="0.001" cone="elliptic" impratio="10"/><worldbody>
  <geom name="floor" type="plane" size="50 50 0.1" friction="0.3"/>
  <body name="case" pos="0 0 0.02"><freejoint/>
    <geom name="bottom" type="box" size="0.1 0.1 0.02" mass="1" friction="0.3"/></body>
</worldbody></mujoco>
"""


def slid(effects: list[EffectInstance]) -> float:
    """How far a flat box slides that is set going at 1 m/s, m."""
    engine = make_backend("mujoco", add_effects(load_scene(SLIDE), effects))
    state = engine.reset()
    state.qvel[:, 0] = 1.0
    return float(engine.rollout(state, np.zeros((800, 0))).qpos[0, -1, 0])


@pytest.mark.parametrize(
    "effect",
    [
        EffectInstance("constant_force", "case", {"magnitude": 6.0, "x": 0, "y": 0, "z": -6.0}),
        EffectInstance("buoyancy", "case", {"displaced_mass": 0.4}),
    ],
    ids=lambda one: one.effect,
)
def test_a_force_on_what_slides_is_like_another_friction(effect: EffectInstance) -> None:
    model = load_scene(SLIDE).model
    (other,) = find(effect.effect).equivalents(model, effect)
    assert (other.effect, other.target) == ("sliding_friction", "bottom")
    declared, forced = slid([]), slid([effect])
    assert abs(forced / declared - 1) > 0.3
    assert slid([other]) == pytest.approx(forced, rel=0.03)


def test_adhesion_to_what_it_slides_on_is_like_more_friction() -> None:
    sticky = EffectInstance("adhesion", "bottom", {"force": 6.0})
    (other,) = find("adhesion").equivalents(load_scene(SLIDE).model, sticky)
    assert (other.effect, other.target) == ("sliding_friction", "bottom")
    declared, held = slid([]), slid([sticky])
    assert abs(slid([other]) - held) < 0.3 * abs(declared - held)  # each contact holds by itself


def test_a_force_that_does_not_press_is_like_no_friction() -> None:
    model, force = load_scene(SLIDE).model, find("constant_force")
    aside = EffectInstance("constant_force", "case", {"magnitude": 5, "x": 4, "y": 0, "z": -3})
    lifted = EffectInstance("constant_force", "case", {"magnitude": 11, "x": 0, "y": 0, "z": 11})
    assert force.equivalents(model, aside) == [] and force.equivalents(model, lifted) == []
    held = load_scene(SLIDE.replace("<freejoint/>", '<joint type="slide" axis="1 0 0"/>')).model
    down = EffectInstance("constant_force", "case", {"magnitude": 6, "x": 0, "y": 0, "z": -6})
    assert force.equivalents(held, down) == []


def test_friction_that_hardly_depends_on_the_direction_is_friction() -> None:
    model = load_scene(SLIDE).model
    values = {"ratio": 1.1, "coefficient": 0.4}
    special = EffectInstance("anisotropic_friction", "bottom", values)
    (found,) = find("sliding_friction").generalized(model, special)
    assert found == pytest.approx({"coefficient": 0.42})
    torsional = EffectInstance("torsional_friction", "bottom", {"coefficient": 0.01})
    assert find("sliding_friction").generalized(model, torsional) == []


def test_the_declared_spring_is_neutral() -> None:
    stiffness, ratio = find("contact_compliance").parameters(load_scene(SLOPE).model, "box")
    # MuJoCo's (timeconst, dampratio): k = 1 / (timeconst dampratio)^2
    assert stiffness.neutral == pytest.approx(1 / 0.02**2)
    assert ratio.neutral == 1.0


@pytest.mark.parametrize(
    ("name", "index", "condim"),
    [("sliding_friction", 0, 3), ("torsional_friction", 1, 4), ("rolling_friction", 2, 6)],
)
def test_coefficients_and_the_dimension_in_which_they_act(
    name: str, index: int, condim: int
) -> None:
    model = add_effects(
        load_scene(SLOPE), [EffectInstance(name, "box", {"coefficient": 0.07})]
    ).model
    assert model.geom("box").friction[index] == 0.07
    assert model.geom("box").condim[0] == condim


def test_only_what_collides_and_moves() -> None:
    assert find("sliding_friction").targets(load_scene(SLOPE).model) == ("box",)
    ghost = SLOPE.replace(
        'name="box" type="box"', 'name="box" contype="0" conaffinity="0" type="box"'
    )
    assert find("sliding_friction").targets(load_scene(ghost).model) == ()


def test_pairs_need_names() -> None:
    scene = load_scene(SLOPE.replace('name="floor"', ""))
    values = {"ratio": 2.0, "coefficient": 0.1}
    with pytest.raises(InputError, match="needs named geoms"):
        add_effects(scene, [EffectInstance("anisotropic_friction", "box", values)])


def test_trials_of_adhesion_are_parts_of_the_weight() -> None:
    model = load_scene(SLOPE).model
    forces = [trial["force"] for trial in find("adhesion").trials(model, "box")]
    weight = np.hypot(3, 9)
    np.testing.assert_allclose(forces, [0.1 * weight, 0.4 * weight, 1.5 * weight])


def test_trials_of_friction_are_less_and_more_than_what_acts() -> None:
    """Where the floor has the say, its friction is what a trial differs from."""
    ruled = SLOPE.replace('name="floor"', 'name="floor" priority="1" friction="0.3"')
    model = load_scene(ruled).model
    (parameter,) = find("sliding_friction").parameters(model, "box")
    levels = [trial["coefficient"] for trial in find("sliding_friction").trials(model, "box")]
    assert parameter.neutral == pytest.approx(0.3)
    assert 0.21 in np.round(levels, 9) and 0.42 in np.round(levels, 9)
    assert {
        trial["coefficient"] for trial in find("anisotropic_friction").trials(model, "box")
    } == {0.3}
