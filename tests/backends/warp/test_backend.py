"""MuJoCo-Warp: buffers that grow, scenes that it cannot simulate, reports."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend, suite
from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.testing import scenes

pytest.importorskip("mujoco_warp")

HEAP = """
<mujoco>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <replicate count="6" offset="0.25 0 0"><body pos="0 0 0.1"><freejoint/>
      <geom type="box" size="0.1 0.1 0.1"/></body></replicate>
  </worldbody>
</mujoco>
"""


def test_buffers_grow_and_the_result_is_the_same() -> None:
    scene = load_scene(HEAP)
    small = make_backend("warp", scene, nworld=2, nconmax=1, njmax=1)
    large = make_backend("warp", scene, nworld=2, nconmax=200, njmax=800)
    a, b = (engine.step(engine.reset(), None, 20) for engine in (small, large))
    np.testing.assert_allclose(a.qpos, b.qpos, atol=1e-6)
    assert a.qpos[0, 2] == pytest.approx(0.1, abs=1e-3)  # it did not fall through
    rolled = make_backend("warp", scene, nworld=2, nconmax=1, njmax=1)
    trajectory = rolled.rollout(rolled.reset(), np.zeros((20, 0)))
    np.testing.assert_allclose(trajectory.qpos[:, -1], b.qpos, atol=1e-6)


def test_what_is_not_supported_is_said() -> None:
    scene = load_scene("""
        <mujoco><option integrator="RK4"/>
        <worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
        <actuator><pid joint="j" kp="1" ki="1"/></actuator></mujoco>""")
    with pytest.raises(UnsupportedSceneError, match="MuJoCo-Warp cannot simulate it"):
        make_backend("warp", scene)


def test_unknown_devices() -> None:
    with pytest.raises(InputError, match="has no device 'cuda:7'"):
        make_backend("warp", load_scene(scenes.PENDULUM), device="cuda:7")


def test_torch_arrays_stay_torch() -> None:
    torch = pytest.importorskip("torch")
    engine = make_backend("warp", load_scene(scenes.CARTPOLE), nworld=3, arrays="torch")
    state = engine.reset()
    controls = torch.zeros(3, 4, 1)
    trajectory = engine.rollout(state, controls)
    assert isinstance(trajectory.qpos, torch.Tensor)
    assert trajectory.qpos.dtype == torch.float32
    plain = make_backend("warp", load_scene(scenes.CARTPOLE), nworld=3)
    expected = plain.rollout(plain.reset(), np.zeros((3, 4, 1)))
    np.testing.assert_allclose(trajectory.qpos.numpy(), expected.qpos, atol=1e-7)


@pytest.mark.parametrize(("domain", "task"), [("cartpole", "swingup"), ("hopper", "hop")])
def test_tasks_of_the_suite(domain: str, task: str) -> None:
    """Touch sensors, which belong to the acceleration stage, come from warp."""
    environment = suite.load(domain, task, {"random": 0}, backend="warp")
    environment.reset()
    spec = environment.action_spec()
    for _ in range(3):
        step = environment.step(np.zeros(spec.shape))
        assert np.isfinite(step.reward)
        assert all(np.isfinite(value).all() for value in step.observation.values())


def test_acceleration_fields_are_warps_own() -> None:
    scene = Scene.from_model(suite.load("hopper", "hop").physics.model.ptr)
    reports = {}
    for name in ("mujoco", "warp"):
        engine = make_backend(name, scene)
        engine.report = {"qacc", "qfrc_actuator", "sensordata", "actuator_force"}
        start = engine.reset()
        state = engine.step(start, np.full(scene.model.nu, 0.3), 3)
        reports[name] = state.memory
    for field in ("qacc", "qfrc_actuator", "sensordata", "actuator_force"):
        a, b = reports["mujoco"][field], reports["warp"][field]
        np.testing.assert_allclose(b, a, atol=1e-3 * (1 + np.abs(a).max()), err_msg=field)


@pytest.mark.slow
@pytest.mark.parametrize("arrays", ["numpy", "torch"])
def test_what_positions_and_velocities_say_is_mujocos(arrays: str) -> None:
    model = suite.load("hopper", "hop").physics.model.ptr
    scene = Scene.from_model(model, source="hopper")
    engine = make_backend("warp", scene, nworld=3, device="cpu", arrays=arrays)
    random = np.random.default_rng(0)
    start = make_backend("mujoco", scene, nworld=3).reset()
    qpos = start.qpos + random.uniform(-0.3, 0.3, start.qpos.shape)
    state = dataclasses.replace(start, qpos=qpos, qvel=random.normal(size=start.qvel.shape))
    found = engine.derive(state, engine.derivable)
    needed = np.asarray(model.sensor_needstage)[np.repeat(range(model.nsensor), model.sensor_dim)]
    moves = needed != mujoco.mjtStage.mjSTAGE_ACC
    assert moves.any() and not moves.all()
    data = mujoco.MjData(model)
    for world in range(3):
        data.qpos, data.qvel = state.qpos[world], state.qvel[world]
        mujoco.mj_forward(model, data)
        for name, rows in found.items():
            mine, theirs = np.asarray(rows[world]), getattr(data, name)
            assert mine.shape == theirs.shape, name
            if name == "sensordata":
                mine, theirs = mine[moves], theirs[moves]
            np.testing.assert_allclose(mine, theirs, atol=2e-5, err_msg=name)
    with pytest.raises(InputError, match="does not derive qacc"):
        engine.derive(state, ["qacc"])
