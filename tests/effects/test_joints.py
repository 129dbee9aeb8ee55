"""Effects at joints: edits against MJCF, and what regressions see against the force itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.errors import InputError

from .motion import WAVE, Motion, added, found, offered


def test_armature(scene: Scene) -> None:
    changed = add_effects(scene, [EffectInstance("armature", "elbow", {"inertia": 0.02})])
    assert changed.model.dof_armature[1] == scene.model.dof_armature[1] + 0.02


def test_hard_stop(scene: Scene) -> None:
    values = {"position": 0.6, "side": 1.0}
    changed = add_effects(scene, [EffectInstance("hard_stop", "shoulder", values)])
    engine = make_backend("mujoco", changed)
    state = engine.reset()
    top = 0.0
    for _ in range(50):
        state = engine.step(state, [0.0, 0.0], 20)  # it falls onto the stop
        top = max(top, float(state.qpos[0, 0]))
    assert 0.59 < top < 0.65
    low = {"position": -0.5, "side": -1.0}
    both = add_effects(changed, [EffectInstance("hard_stop", "shoulder", low)]).model
    np.testing.assert_allclose(both.joint("shoulder").range, [-0.5, 0.6])
    np.testing.assert_array_equal(both.jnt_solref, scene.model.jnt_solref)


def test_a_stop_is_as_stiff_and_as_damped_as_said(scene: Scene) -> None:
    """It throws the joint back, which MuJoCo's default does not."""
    soft = EffectInstance("hard_stop", "shoulder", {"position": 0.6, "side": 1.0})
    stiff = soft.replace(timeconst=0.01, dampratio=0.2)

    def fall(stop: EffectInstance) -> tuple[float, float]:
        engine = make_backend("mujoco", add_effects(scene, [stop]))
        state = engine.reset()
        motion = []
        for _ in range(1000):
            state = engine.step(state, [0.0, 0.0], 1)
            motion.append((float(state.qpos[0, 0]), float(state.qvel[0, 0])))
        depth, back = np.array(motion).max(axis=0)[0], np.array(motion).min(axis=0)[1]
        return float(depth), float(back)

    assert fall(stiff)[0] < fall(soft)[0] and fall(stiff)[1] < 2 * fall(soft)[1] < 0
    free = find("hard_stop").encode(scene.model, "shoulder", soft.values)
    assert free == {"position": 0.6, "timeconst": 0.02, "dampratio": 1.0}
    assert find("hard_stop").complete(scene.model, "shoulder", {**stiff.values, "timeconst": 1e-4})[
        "timeconst"
    ] == pytest.approx(2 * scene.model.opt.timestep)


@pytest.mark.parametrize(
    ("effect", "values"),
    [("backlash", {"width": 0.04}), ("joint_flexibility", {"stiffness": 50.0, "damping": 0.2})],
)
def test_effects_with_a_joint_of_their_own(scene: Scene, effect: str, values: dict) -> None:
    changed = add_effects(scene, [EffectInstance(effect, "shoulder", values)]).model
    assert changed.nv == scene.model.nv + 1
    own, extra = changed.joint("shoulder"), changed.joint(f"shoulder_{effect.split('_')[-1]}")
    assert own.bodyid == extra.bodyid
    assert changed.actuator("m1").trnid[0] == own.id  # the actuator stays with the motor
    if effect == "backlash":
        np.testing.assert_allclose(extra.range, [-0.02, 0.02])
    else:
        assert extra.stiffness[0] == 50.0


FITTED = {
    # effect: which of its candidates, and coefficients
    "coulomb_friction": (0, [0.3]),
    "viscous_damping": (0, [0.3]),
    "quadratic_damping": (0, [0.3]),
    "joint_spring": (0, [4.0, 0.4]),
    "armature": (0, [0.02]),
    "cogging": (0, [0.2, 0.3]),
    "stribeck_friction": (3, [0.2, 0.5]),
    "load_dependent_friction": (0, [0.2]),
    "joint_coupling": (1, [0.7]),
}


@pytest.mark.parametrize("name", FITTED)
@pytest.mark.parametrize("target", ["shoulder", "elbow"])
def test_regressions_see_the_force(scene: Scene, motion: Motion, name: str, target: str) -> None:
    number, coefficients = FITTED[name]
    candidate = find(name).screen(motion, target)[number]
    expected = added(scene, motion, found(candidate, coefficients))
    rows = np.ones(len(expected), bool)
    if name == "coulomb_friction":  # a soft constraint: in full where the joint really moves
        rows = np.abs(motion.qvel[:, scene.model.joint(target).dofadr[0]]) > 0.1
        assert rows.sum() > 8
    np.testing.assert_allclose(offered(candidate, coefficients)[rows], expected[rows], atol=1e-9)
    assert np.abs(expected).max() > 0.01


def test_all_sources_of_a_coupling_are_seen(scene: Scene, motion: Motion) -> None:
    candidates = find("joint_coupling").screen(motion, "elbow")
    assert [c.options["by"] for c in candidates] == ["torque", "position", "velocity"]
    for candidate in candidates:
        assert candidate.options["other"] == "shoulder"
        expected = added(scene, motion, found(candidate, [0.7]))
        np.testing.assert_allclose(offered(candidate, [0.7]), expected, atol=1e-9)


@pytest.mark.parametrize("name", ["coulomb_friction", "quadratic_damping", "armature"])
def test_what_cannot_be_negative_is_not_found_so(motion: Motion, name: str) -> None:
    assert find(name).screen(motion, "elbow")[0].solve(np.array([-0.1])) is None


def test_a_wave_has_amplitude_and_phase(motion: Motion) -> None:
    values = find("cogging").screen(motion, "elbow")[0].solve(np.array([0.0, -2.0]))
    assert values == {"amplitude": 2.0, "periods": WAVE, "phase": pytest.approx(-np.pi / 2)}


def test_a_stop_is_a_spring_at_an_end_of_the_travel(scene: Scene, motion: Motion) -> None:
    q = motion.qpos[:, 1]
    for candidate in find("hard_stop").screen(motion, "elbow"):
        values = candidate.solve(np.array([3.0, 0.1]))
        assert values is not None
        beyond = values["side"] * (q - values["position"])
        assert 0 < beyond.max() < 0.2 * np.ptp(q)
        push = candidate.columns[0].values[:, 1]
        np.testing.assert_allclose(push, -values["side"] * np.clip(beyond, 0, None))
        assert candidate.solve(np.array([-3.0, 0.1])) is None


def test_only_hinges_and_slides(scene: Scene) -> None:
    for name in FITTED:
        assert find(name).targets(scene.model) == ("shoulder", "elbow"), name
    sprung = add_effects(
        scene, [EffectInstance("joint_spring", "elbow", {"stiffness": 1, "rest_position": 0})]
    )
    assert find("joint_spring").targets(sprung.model) == ("shoulder",)


def test_a_coupling_needs_two_joints() -> None:
    one = load_scene(
        "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
    )
    assert find("joint_coupling").targets(one.model) == ()


def test_angles_are_written_in_the_documents_unit() -> None:
    degrees = load_scene(
        "<mujoco><worldbody><body><joint name='j'/><geom size='1'/></body></worldbody></mujoco>"
    )
    spring = EffectInstance("joint_spring", "j", {"stiffness": 1.0, "rest_position": 0.5})
    stop = EffectInstance("hard_stop", "j", {"position": 0.7, "side": 1.0})
    model = add_effects(degrees, [spring, stop]).model
    assert model.qpos_spring[0] == pytest.approx(0.5)
    assert model.jnt_range[0, 1] == pytest.approx(0.7)


@pytest.mark.parametrize("options", [{"other": "shoulder", "by": "sight"}, {"other": "knee"}])
def test_couplings_to_nothing_are_refused(scene: Scene, options: dict[str, str]) -> None:
    one = EffectInstance("joint_coupling", "elbow", {"coefficient": 1.0}, options)
    with pytest.raises(InputError, match=r"by is torque, position or velocity|knee"):
        find("joint_coupling").hook(scene.model, one)


def test_loads_that_do_not_exist_are_refused(scene: Scene) -> None:
    one = EffectInstance(
        "load_dependent_friction", "elbow", {"coefficient": 1.0}, {"load": "inner"}
    )
    with pytest.raises(InputError, match="load is one of actuator, external"):
        find("load_dependent_friction").hook(scene.model, one)


@pytest.mark.parametrize("frequency", [0, 1, 2])
def test_an_elastic_transmission_swings_as_it_is_asked_to(scene: Scene, frequency: int) -> None:
    values = find("joint_flexibility").trials(scene.model, "elbow")[frequency]
    omega = 2 * np.pi * (3.0, 8.0, 20.0)[frequency]
    inertia = scene.model.dof_M0[1]
    assert values["stiffness"] / inertia == pytest.approx(omega**2)
    assert values["damping"] / inertia == pytest.approx(0.1 * omega)


HINGE = load_scene(
    """
<mujoco><worldbody><body><joint name="hinge"/><geom size=".1"/></body></worldbody></mujoco>
"""
).model
LEVEL = st.floats(0, 100)


@given(coulomb=LEVEL, static=LEVEL, velocity=st.floats(1e-3, 10))
def test_static_friction_there_and_back(coulomb: float, static: float, velocity: float) -> None:
    effect = find("stribeck_friction")
    values = {"coulomb": coulomb, "static": static, "velocity": velocity}
    free = effect.encode(HINGE, "hinge", values)
    assert tuple(free) == effect.free_parameters(HINGE, "hinge")
    again = effect.complete(HINGE, "hinge", free)
    assert again["static"] == pytest.approx(max(static, coulomb))
    assert (again["coulomb"], again["velocity"]) == (coulomb, velocity)


def test_static_friction_is_not_less_than_coulombs() -> None:
    effect = find("stribeck_friction")
    found = effect.complete(HINGE, "hinge", {"coulomb": 2.0, "excess": -1.0, "velocity": 0.1})
    assert found["static"] == 2.0


def test_a_value_at_the_edge_of_what_a_machine_has_is_none() -> None:
    effect, known = find("load_dependent_friction"), {"load": "actuator"}
    inside, edge = (
        EffectInstance(effect.name, "hinge", {"coefficient": value}, known) for value in (0.3, 0.5)
    )
    assert effect.log_prior(HINGE, inside) > -np.inf
    assert effect.log_prior(HINGE, edge) == -np.inf


def test_sizes_say_how_much_there_is() -> None:
    assert find("cogging").sizes(HINGE, "hinge") == ("amplitude",)
    assert find("stribeck_friction").sizes(HINGE, "hinge") == ("coulomb", "excess")
    assert find("coulomb_friction").sizes(HINGE, "hinge") == ("torque",)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_stop_is_possible_on_either_side(scene: Scene, side: float) -> None:
    """Its side is a bound of what sides there are, and no fit has ended there."""
    stop = EffectInstance("hard_stop", "shoulder", {"position": 0.3 * side, "side": side})
    assert find("hard_stop").log_prior(scene.model, stop) == 0.0
