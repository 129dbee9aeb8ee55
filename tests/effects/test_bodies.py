"""Effects on bodies: edits against MJCF, and what regressions see against the force itself."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim import Scene, load_scene
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.effects.bodies import inertial_of

from .arm import ARM, start
from .motion import WAVE, Motion, added, found, offered

MODEL = load_scene(ARM).model


def test_gravity_tilt(scene: Scene) -> None:
    tilted = add_effects(
        scene, [EffectInstance("gravity_tilt", "world", {"angle": 3, "x": 0.5, "y": 0, "z": -9.8})]
    )
    np.testing.assert_array_equal(tilted.model.opt.gravity, [0.5, 0, -9.8])


def test_payload_is_a_point_mass(scene: Scene) -> None:
    values = {"mass": 0.4, "com_x": 0.2, "com_y": 0.05, "com_z": -0.1}
    changed = add_effects(scene, [EffectInstance("payload", "fore", values)]).model
    spec = scene.spec
    body = spec.body("fore").add_body(pos=[0.2, 0.05, -0.1])
    body.mass, body.inertia, body.ipos = 0.4, [1e-12] * 3, [0, 0, 0]
    body.explicitinertial = True
    welded = spec.compile()
    data = [mujoco.MjData(m) for m in (changed, welded)]
    for m, d in zip((changed, welded), data, strict=True):
        d.qpos[:], d.qvel[:] = start(m)
        mujoco.mj_forward(m, d)
    np.testing.assert_allclose(data[0].qfrc_bias, data[1].qfrc_bias, atol=1e-9)
    np.testing.assert_allclose(data[0].M, data[1].M, atol=1e-9)


def test_com_offset(scene: Scene) -> None:
    values = {"offset": 0.05, "x": 0.03, "y": 0.0, "z": 0.04}
    changed = add_effects(scene, [EffectInstance("com_offset", "upper", values)]).model
    shift = changed.body("upper").ipos - scene.model.body("upper").ipos
    np.testing.assert_allclose(shift, [0.03, 0, 0.04], atol=1e-12)
    np.testing.assert_allclose(changed.body_inertia, scene.model.body_inertia, atol=1e-12)


def _payload(mass: float, at: np.ndarray) -> list[float]:
    """Mass, first and second moments."""
    x, y, z = at
    second = [x * x, y * y, z * z, x * y, x * z, y * z]
    return [mass, *(mass * at), *(mass * one for one in second)]


FITTED = {
    "payload": _payload(0.4, np.array([0.2, 0.05, -0.1])),
    "buoyancy": [0.3],
    "constant_force": [1.0, 2.0, -2.0],
    "linear_drag": [0.4],
    "quadratic_drag": [0.4],
    "magnus": [0.4],
    "periodic_disturbance": [0.3, -0.4],
}


@pytest.mark.parametrize("target", ["fore", "ball"])
@pytest.mark.parametrize("name", FITTED)
def test_regressions_see_the_force(scene: Scene, motion: Motion, name: str, target: str) -> None:
    effect = find(name)
    if target not in effect.targets(scene.model):
        assert target == "fore"
        return
    candidate = effect.screen(motion, target)[0]
    expected = added(scene, motion, found(candidate, FITTED[name]))
    np.testing.assert_allclose(offered(candidate, FITTED[name]), expected, atol=1e-8)
    assert np.abs(expected).max() > 0.01


def test_a_payload_at_a_known_place(scene: Scene, motion: Motion) -> None:
    _, *placed = find("payload").screen(motion, "upper")
    assert len(placed) == 2  # its centre of mass (its geom's too), and where the forearm begins
    for candidate in placed:
        expected = added(scene, motion, found(candidate, [0.4]))
        np.testing.assert_allclose(offered(candidate, [0.4]), expected, atol=1e-8)


def test_a_disturbance_along_each_axis_and_at_joints(scene: Scene, motion: Motion) -> None:
    effect = find("periodic_disturbance")
    along = [*effect.screen(motion, "ball"), *effect.screen(motion, "elbow")]
    assert len(along) == 4
    for candidate in along:
        one = found(candidate, [0.3, 0.4])
        assert one.values["frequency"] == WAVE
        expected = added(scene, motion, one)
        np.testing.assert_allclose(offered(candidate, [0.3, 0.4]), expected, atol=1e-9)


def test_small_offsets_and_tilts_are_seen_to_first_order(scene: Scene, motion: Motion) -> None:
    (offset,) = find("com_offset").screen(motion, "ball")
    (tilt,) = find("gravity_tilt").screen(motion, "world")
    small = np.array([1e-5, -2e-5, 3e-5])
    expected = added(scene, motion, found(offset, small))
    assert np.abs(expected).max() > 1e-5
    np.testing.assert_allclose(offered(offset, small), expected, atol=1e-8)
    angles = dict(tilt.solve(small[:2]) or {})
    values = find("gravity_tilt").complete(scene.model, "world", angles)
    expected = added(scene, motion, EffectInstance("gravity_tilt", "world", dict(values)))
    assert np.abs(expected).max() > 1e-5
    np.testing.assert_allclose(offered(tilt, small[:2]), expected, atol=1e-7)


@given(one=st.floats(-1, 1), two=st.floats(-1, 1))
def test_a_tilt_there_and_back(one: float, two: float) -> None:
    effect = find("gravity_tilt")
    values = effect.complete(MODEL, "world", {"tilt_1": one, "tilt_2": two})
    tilted = np.array([values[axis] for axis in "xyz"])
    down = MODEL.opt.gravity
    assert np.linalg.norm(tilted) == pytest.approx(9.81)
    cosine = tilted @ down / 9.81**2
    assert np.cos(np.radians(values["angle"])) == pytest.approx(cosine, abs=1e-9)
    again = effect.encode(MODEL, "world", values)
    assert again == {"tilt_1": pytest.approx(one), "tilt_2": pytest.approx(two)}


def test_a_payload_moves_the_centre_of_mass_as_the_offset_that_it_is_taken_for(
    scene: Scene,
) -> None:
    values = {"mass": 0.4, "com_x": 0.2, "com_y": 0.05, "com_z": -0.1}
    payload = EffectInstance("payload", "fore", values)
    heavier = add_effects(scene, [payload]).model
    (offset,) = find("com_offset").generalized(scene.model, payload)
    moved = heavier.body("fore").ipos - scene.model.body("fore").ipos
    np.testing.assert_allclose([offset[axis] for axis in "xyz"], moved, atol=1e-12)
    assert offset["offset"] == pytest.approx(np.linalg.norm(moved))
    instance = EffectInstance("com_offset", "fore", dict(offset))
    for back in find("payload").generalized(scene.model, instance):
        again = add_effects(scene, [EffectInstance("payload", "fore", dict(back))]).model
        np.testing.assert_allclose(again.body("fore").ipos, heavier.body("fore").ipos, atol=1e-9)


def test_inertia_as_compiled(scene: Scene) -> None:
    mass, pos, quat, inertia = inertial_of(scene.spec, "fore")
    body = scene.model.body("fore")
    assert mass == body.mass[0]
    for got, expected in ((pos, body.ipos), (quat, body.iquat), (inertia, body.inertia)):
        np.testing.assert_array_equal(got, expected)


def test_only_what_moves() -> None:
    model = load_scene(
        """<mujoco><worldbody><body name="wall"><geom size="1"/></body><body name="b"><joint/>
        <geom size="1"/><body name="welded"><geom size="1"/></body></body></worldbody></mujoco>"""
    ).model
    assert find("payload").targets(model) == ("b", "welded")
    assert find("magnus").targets(model) == ()


def test_tilts_are_tried_to_four_sides(scene: Scene) -> None:
    effect, size = find("gravity_tilt"), np.linalg.norm(scene.model.opt.gravity)
    tried = effect.trials(scene.model, "world")
    sides = np.array([[one[axis] for axis in "xyz"] for one in tried])
    np.testing.assert_allclose(np.linalg.norm(sides, axis=1), size)
    np.testing.assert_allclose([one["angle"] for one in tried], 0.5)
    np.testing.assert_allclose(
        sides.mean(axis=0), np.cos(np.radians(0.5)) * scene.model.opt.gravity
    )
    assert len({tuple(np.round(side, 6)) for side in sides}) == 4
    neutral = effect.neutral(scene.model, "world")
    np.testing.assert_array_equal([neutral[axis] for axis in "xyz"], scene.model.opt.gravity)
