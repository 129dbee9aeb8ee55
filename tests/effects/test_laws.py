"""Every effect does what its definition says: forces against formulas, edits against MJCF."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

from orbisim import Physics, Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, carried_effects, effect_names, find
from orbisim.errors import InputError, SceneError, UnknownNameError

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/>
      <geom name="u" type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      <body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 1 0.3"/>
        <geom name="f" type="capsule" fromto="0 0 0 0.25 0 0.1" size="0.02" mass="0.5"/></body></body>
    <body name="ball" pos="2 0 1"><freejoint name="free"/>
      <geom name="ball" type="box" size="0.1 0.05 0.02" mass="0.7"/></body>
  </worldbody>
  <contact><exclude body1="upper" body2="fore"/></contact>
  <actuator>
    <motor name="m1" joint="shoulder" gear="2"/>
    <position name="p2" joint="elbow" kp="5" kv="0.1"/>
  </actuator>
  <sensor><jointpos name="s1" joint="shoulder"/></sensor>
</mujoco>
"""
CTRL = np.array([0.8, -0.45])  # a mild acceleration: frictionloss opposes the velocity
SPEED = np.array([1.5, -2.0, 0.8, 0.3, -0.5, 2.0, -1.0, 3.0])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(ARM)


def start(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    qpos = np.array(model.qpos0)
    qpos[:2] = [0.4, -0.7]
    return qpos, SPEED.copy()


def generalized_force(scene: Scene, time: float = 0.0, backend: str = "mujoco") -> np.ndarray:
    """M(q) a + bias from one very short step: all forces but gravity and Coriolis."""
    engine = make_backend(backend, scene)
    engine.report = {"qacc"}
    qpos, qvel = start(scene.model)
    state = engine.reset().replace(qpos=qpos[None], qvel=qvel[None], time=np.array([time]))
    after = engine.step(state, CTRL)
    data = mujoco.MjData(scene.model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(scene.model, data)
    full = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, full)
    return full @ after.memory["qacc"][0] + data.qfrc_bias


def velocities(model: mujoco.MjModel, body: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angular and linear velocity of the centre of mass in the world, and its Jacobian."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start(model)
    mujoco.mj_forward(model, data)
    jacp, jacr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacp, jacr, model.body(body).id)
    return jacr @ data.qvel, jacp @ data.qvel, jacp


def unit(index: int) -> np.ndarray:
    return np.eye(8)[index]


V1, V2 = SPEED[0], SPEED[1]
FORCES = {
    # effect, target, values, options: the force it adds
    "coulomb": (("coulomb_friction", "shoulder", {"torque": 0.3}), lambda m: -0.3 * unit(0)),
    "viscous": (("viscous_damping", "elbow", {"coefficient": 0.3}), lambda m: -0.3 * V2 * unit(1)),
    "quadratic": (
        ("quadratic_damping", "elbow", {"coefficient": 0.3}),
        lambda m: -0.3 * V2 * abs(V2) * unit(1),
    ),
    "spring": (
        ("joint_spring", "shoulder", {"stiffness": 4.0, "rest_position": 0.1}),
        lambda m: -4 * (0.4 - 0.1) * unit(0),
    ),
    "cogging": (
        ("cogging", "shoulder", {"amplitude": 0.2, "periods": 7.0, "phase": 0.5}),
        lambda m: 0.2 * np.sin(7 * 0.4 + 0.5) * unit(0),
    ),
    "stribeck": (
        ("stribeck_friction", "elbow", {"coulomb": 0.2, "static": 0.5, "velocity": 3.0}),
        lambda m: (0.2 + 0.3 * np.exp(-((V2 / 3) ** 2))) * unit(1),
    ),
    "load, actuator": (
        ("load_dependent_friction", "shoulder", {"coefficient": 0.2}),
        lambda m: -0.2 * abs(2 * 0.8) * unit(0),
    ),
    "coupling, torque": (
        ("joint_coupling", "elbow", {"coefficient": 0.2}, {"other": "shoulder"}),
        lambda m: 0.2 * 1.6 * unit(1),
    ),
    "coupling, position": (
        ("joint_coupling", "elbow", {"coefficient": 2.0}, {"other": "shoulder", "by": "position"}),
        lambda m: 2 * 0.4 * unit(1),
    ),
    "coupling, velocity": (
        ("joint_coupling", "elbow", {"coefficient": 0.5}, {"other": "shoulder", "by": "velocity"}),
        lambda m: 0.5 * 1.5 * unit(1),
    ),
    "gain": (("torque_gain", "m1", {"gain": 1.5}), lambda m: 0.5 * 1.6 * unit(0)),
    "gain, position": (
        ("torque_gain", "p2", {"gain": 0.5}),
        lambda m: -0.5 * (5 * (-0.45 + 0.7) - 0.1 * V2) * unit(1),
    ),
    "bias": (("torque_bias", "m1", {"offset": 0.3}), lambda m: 2 * 0.3 * unit(0)),
    "saturation": (
        ("torque_saturation", "p2", {"limit": 1.0}),
        lambda m: -(5 * (-0.45 + 0.7) - 0.1 * V2 - 1.0) * unit(1),
    ),
    "dead band": (("deadband", "m1", {"width": 0.4}), lambda m: -2 * 0.2 * unit(0)),
    "dead band, gate": (
        ("deadband", "m1", {"width": 1.8}, {"kind": "gate"}),
        lambda m: -1.6 * unit(0),
    ),
    "constant force": (
        ("constant_force", "fore", {"magnitude": 3.0, "x": 1.0, "y": 2.0, "z": -2.0}),
        lambda m: velocities(m, "fore")[2].T @ [1, 2, -2],
    ),
    "periodic, joint": (
        ("periodic_disturbance", "elbow", {"amplitude": 0.5, "frequency": 3.0, "phase": 0.2}),
        lambda m: 0.5 * np.sin(2 * np.pi * 3 * 0.1 + 0.2) * unit(1),
    ),
    "periodic, body": (
        (
            "periodic_disturbance", "ball",
            {"amplitude": 0.5, "frequency": 3.0, "phase": 0.2}, {"x": "0", "y": "2", "z": "0"},
        ),
        lambda m: velocities(m, "ball")[2].T @ [0, 0.5 * np.sin(2 * np.pi * 0.3 + 0.2), 0],
    ),
    "linear drag": (
        ("linear_drag", "fore", {"coefficient": 0.4}),
        lambda m: velocities(m, "fore")[2].T @ (-0.4 * velocities(m, "fore")[1]),
    ),
    "quadratic drag": (
        ("quadratic_drag", "ball", {"coefficient": 0.4}),
        lambda m: velocities(m, "ball")[2].T
        @ (-0.4 * velocities(m, "ball")[1] * np.linalg.norm(velocities(m, "ball")[1])),
    ),
    "magnus": (
        ("magnus", "ball", {"coefficient": 0.4}),
        lambda m: velocities(m, "ball")[2].T @ (0.4 * np.cross(*velocities(m, "ball")[:2])),
    ),
    "buoyancy": (
        ("buoyancy", "fore", {"displaced_mass": 0.3}),
        lambda m: velocities(m, "fore")[2].T @ [0, 0, 0.3 * 9.81],
    ),
}  # fmt: skip


@pytest.mark.parametrize("backend", ["mujoco", "warp"])
@pytest.mark.parametrize("case", FORCES)
def test_force(scene: Scene, case: str, backend: str) -> None:
    if backend == "warp":
        pytest.importorskip("mujoco_warp")
    arguments, law = FORCES[case]
    changed = add_effects(scene, [EffectInstance(*arguments)])
    added = generalized_force(changed, 0.1, backend) - generalized_force(scene, 0.1, backend)
    expected = law(scene.model)
    # dissipative forces are integrated implicitly: correct to first order in the timestep
    np.testing.assert_allclose(added, expected, atol=0.01 * np.abs(expected).max() + 1e-3)


def test_gravity_tilt(scene: Scene) -> None:
    tilted = add_effects(
        scene, [EffectInstance("gravity_tilt", "world", {"angle": 3, "x": 0.5, "y": 0, "z": -9.8})]
    )
    np.testing.assert_array_equal(tilted.model.opt.gravity, [0.5, 0, -9.8])


def test_armature(scene: Scene) -> None:
    changed = add_effects(scene, [EffectInstance("armature", "elbow", {"inertia": 0.02})])
    assert changed.model.dof_armature[1] == scene.model.dof_armature[1] + 0.02


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


def test_lag_is_a_first_order_filter(scene: Scene) -> None:
    changed = add_effects(scene, [EffectInstance("actuator_lag", "m1", {"time_constant": 0.05})])
    engine = make_backend("mujoco", changed)
    state = engine.step(engine.reset(), [1.0, 0.0], 100)
    assert state.act[0, 0] == pytest.approx(1 - np.exp(-0.05 / 0.05), rel=1e-6)


def test_delay(scene: Scene) -> None:
    changed = add_effects(scene, [EffectInstance("actuator_delay", "m1", {"delay": 0.02})])
    engine = make_backend("mujoco", changed)
    engine.report = {"actuator_force"}
    state = engine.reset()
    forces = []
    for _ in range(60):
        state = engine.step(state, [1.0, 0.0])
        forces.append(state.memory["actuator_force"][0, 0])
    assert np.flatnonzero(forces)[0] == 40


def test_a_delay_of_whole_timesteps_is_the_same_at_all_times(scene: Scene) -> None:
    """Rounding of the time must not decide which of two controls is in force."""
    changed = add_effects(scene, [EffectInstance("actuator_delay", "m1", {"delay": 0.012})])
    steps = round(0.012 / changed.model.opt.timestep)
    data = mujoco.MjData(changed.model)
    controls = np.random.default_rng(1).uniform(-1, 1, 4000)
    forces = []
    for control in controls:
        data.ctrl[0] = control
        mujoco.mj_step(changed.model, data)
        forces.append(data.actuator_force[0])
    gain = changed.model.actuator_gainprm[0, 0]
    np.testing.assert_allclose(forces[steps:], gain * controls[:-steps], rtol=1e-9)


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


BOUNCE = """
<mujoco><option timestep="0.0005"/><worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
  <body name="ball" pos="0 0 0.55"><freejoint/><geom name="ball" type="sphere" size="0.05" mass="0.1"/></body>
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
  <body name="box" pos="0 0 0.05"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.05" mass="1"/></body>
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


# -- carrying ----------------------------------------------------------------------------------

CARRIED = EffectInstance("linear_drag", "fore", {"coefficient": 0.4})


def test_effects_travel_in_the_mjcf(scene: Scene, tmp_path) -> None:
    changed = add_effects(scene, [CARRIED])
    path = changed.save(tmp_path)
    plain = mujoco.MjModel.from_xml_path(str(path))  # plain MuJoCo carries and ignores it
    assert plain.ntext == 1
    again = load_scene(path)
    assert carried_effects(again.model) == (CARRIED,)
    np.testing.assert_allclose(generalized_force(again), generalized_force(changed), atol=1e-9)
    further = add_effects(again, [EffectInstance("deadband", "m1", {"width": 0.1})])
    assert [e.effect for e in carried_effects(further.model)] == ["linear_drag", "deadband"]


def test_physics_applies_carried_effects(scene: Scene) -> None:
    changed = add_effects(scene, [CARRIED])
    for physics in (Physics.from_scene(changed), Physics.from_xml_string(changed.to_xml())):
        physics.data.qpos[:], physics.data.qvel[:] = start(scene.model)
        physics.set_control(CTRL)
        physics.step(50)
        engine = make_backend("mujoco", changed)
        qpos, qvel = start(scene.model)
        state = engine.reset().replace(qpos=qpos[None], qvel=qvel[None])
        expected = engine.step(state, CTRL, 50)
        np.testing.assert_allclose(physics.data.qpos, expected.qpos[0], atol=1e-12)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("not json", "Expecting value"),
        ('{"effect": 1}', "expected a list"),
        ('[{"effect": "linear_drag"}]', "not an effect"),
        ('[{"effect": "no_such", "target": "fore", "parameters": {}}]', "unknown effect"),
        ('[{"effect": "linear_drag", "target": "leg", "parameters": {"coefficient": 1}}]', "'leg'"),
        ('[{"effect": "linear_drag", "target": "fore", "parameters": {}}]', "lacks coefficient"),
        (
            '[{"effect": "linear_drag", "target": "fore", "parameters": {"coefficient": -1}}]',
            "within",
        ),
    ],
)
def test_unreadable_effects_are_refused(data: str, message: str) -> None:
    text = f"<custom><text name='orbisim:effects' data='{data}'/></custom></mujoco>"
    with pytest.raises(SceneError, match=message):
        load_scene(ARM.replace("</mujoco>", text))


def test_impossible_effects_are_refused(scene: Scene) -> None:
    for effect, target, values, error in (
        ("coulomb_friction", "knee", {"torque": 1}, UnknownNameError),
        ("coulomb_friction", "free", {"torque": 1}, InputError),
        ("coulomb_friction", "elbow", {"torque": -1}, InputError),
        ("coulomb_friction", "elbow", {"torque": float("nan")}, InputError),
        ("coulomb_friction", "elbow", {"torqe": 1}, UnknownNameError),
        ("colomb_friction", "elbow", {"torque": 1}, UnknownNameError),
        ("magnus", "fore", {"coefficient": 1}, InputError),
    ):
        with pytest.raises(error):
            add_effects(scene, [EffectInstance(effect, target, values)])


def test_the_catalogue_is_complete() -> None:
    assert len(effect_names()) == 38
    for name in effect_names():
        effect = find(name)
        assert effect.name == name
        assert effect.phrase


def test_json_round_trip() -> None:
    instance = EffectInstance("joint_coupling", "a", {"coefficient": 0.1}, {"other": "b"})
    assert EffectInstance.from_json(json.loads(json.dumps(instance.to_json()))) == instance
