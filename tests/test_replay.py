"""`orbisim.replay`: windows of recordings, simulated from their recorded states."""

from __future__ import annotations

import json
import subprocess
import sys

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim import Recording, Replay, load_scene
from orbisim.backend import Backend, Capability
from orbisim.errors import DivergedError, InputError, RecordingError
from orbisim.recording import capture
from orbisim.state import State

from .recording.scenes import EVERYTHING, PENDULUM, simulate


@pytest.fixture(scope="module")
def scene():
    return load_scene(EVERYTHING)


@pytest.fixture(scope="module")
def trajectory(scene):
    return simulate(scene, 1000)


@pytest.fixture(scope="module")
def recording(scene, trajectory):
    return capture(scene, trajectory)


# -- the scene against itself ----------------------------------------------------------------------


@pytest.mark.parametrize("window", [0.0, 0.25, 0.5])
def test_a_simulation_replays_itself(scene, recording, window):
    result = orbisim.replay(scene, recording, window=window)
    assert result.rms < 1e-12
    assert all(error.rms < 1e-9 for error in result.signals.values())
    assert len(result.windows) == {0.0: 1, 0.25: 8, 0.5: 4}[window]
    assert set(result.signals) == {
        "qpos/shoulder", "qvel/shoulder", "qpos/elbow", "qvel/elbow", "xpos/cube", "xquat/cube",
        "qvel/cube[0:3]", "qvel/cube[3:6]", "qpos/socket", "qvel/socket", "qpos/rail", "qvel/rail",
        "sensor/encoder", "sensor/imu",
    }  # fmt: skip
    assert result.notes == ()


@pytest.mark.parametrize("rate", [1000.0, 250.0, 400.0])
def test_the_sampling_interval_need_not_be_the_timestep(scene, rate):
    """Controls change every 20 ms, which is a multiple of all these intervals."""
    backend = orbisim.make_backend("mujoco", scene)
    rng = np.random.default_rng(0)
    controls = np.repeat(0.3 * rng.standard_normal((50, 2)), 10, axis=0)
    state = backend.reset(1).replace(qvel=rng.standard_normal((1, scene.model.nv)))
    trajectory = backend.rollout(state, controls)
    recording = capture(scene, trajectory, rate=rate)
    result = orbisim.replay(scene, recording.without("sensor/imu"), window=0.4)
    assert result.rms < 1e-9


def test_nonuniform_samples(scene, recording):
    rng = np.random.default_rng(0)
    rows = np.sort(rng.choice(len(recording) - 1, 700, replace=False))
    rows[0] = 0
    constant = recording.replace(
        signals={n: v if not n.startswith("ctrl") else 0 * v for n, v in recording.signals.items()}
    )
    backend = orbisim.make_backend("mujoco", scene)
    start = backend.reset(1).replace(
        qvel=np.concatenate([np.atleast_1d(recording[f"qvel/{n}"][0])
                             for n in ("shoulder", "elbow", "cube", "socket", "rail")])[None]
    )  # fmt: skip
    free = capture(scene, backend.rollout(start, np.zeros((1000, 2))))
    assert constant.signals.keys() == free.signals.keys()
    assert orbisim.replay(scene, free.rows(rows), window=0.3).rms < 1e-11


def test_without_velocities(scene, recording):
    named = [n for n in recording.signals if n.startswith("qvel")]
    result = orbisim.replay(scene, recording.without(*named), window=0.5)
    assert result.rms < 5e-4
    assert (
        "velocities of 'shoulder', 'elbow', 'cube', 'socket', 'rail' are estimated"
        in (result.notes[0])
    )
    assert not any(name.startswith("qvel") for name in result.signals)


def test_noise_reaches_the_result_but_not_the_start(scene, trajectory):
    noisy = capture(scene, trajectory, noise=1e-3, velocities=False, seed=1)
    result = orbisim.replay(scene, noisy, window=0.3)
    assert result.signals["qpos/elbow"].noise == pytest.approx(1e-3, rel=0.15)
    assert result.signals["xquat/cube"].noise == pytest.approx(1e-3, rel=0.15)
    assert result.signals["qpos/elbow"].rms < 6e-3


def test_missing_samples_are_not_scored(scene, recording):
    values = np.array(recording["qpos/elbow"])
    values[100:110] = np.nan
    values[250] = np.nan  # where the second window would start
    partial = recording.replace(signals={**recording.signals, "qpos/elbow": values})
    result = orbisim.replay(scene, partial, window=0.5)
    assert result.rms < 1e-3  # the second window starts from a smoothed position
    assert np.isnan(result.windows[0].error["qpos/elbow"][100:110]).all()
    assert np.isfinite(result.windows[0].error["qpos/elbow"][:100]).all()


def test_two_slow_cameras_in_one_table(scene, recording):
    """No row is complete; every window starts all the same."""
    signals = {n: np.array(v) for n, v in recording.signals.items() if not n.startswith("qvel")}
    signals["qpos/shoulder"][1::2] = np.nan
    signals["qpos/elbow"][0::2] = np.nan
    result = orbisim.replay(scene, recording.replace(signals=signals), window=0.5)
    assert len(result.windows) == 4
    assert result.rms < 2e-3
    assert "1 windows start later or are left out" in result.notes[-1]


# -- errors that are known -------------------------------------------------------------------------


SLIDE = """
<mujoco><option timestep="0.01" gravity="0 0 0" integrator="RK4"/><worldbody>
  <body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="2"/></body>
  <body pos="0 0 9"><joint name="y" type="slide" axis="0 1 0"/><geom size=".1" mass="1"/></body>
</worldbody><actuator><motor name="push" joint="x"/></actuator></mujoco>
"""


def test_errors_are_what_they_are():
    """A constant force of 2 N on 2 kg that the control does not tell of: the error is t^2 / 2."""
    scene = load_scene(SLIDE)
    t = np.arange(301) * 0.01
    x = 0.3 * t + 0.5 * t**2
    signals = {"qpos/x": x, "qvel/x": 0.3 + t, "qpos/y": 0 * t, "ctrl/push": 0 * t}
    result = orbisim.replay(scene, Recording(t, signals), window=1.0)
    assert len(result.windows) == 3
    s = np.arange(101) * 0.01
    expected = 0.5 * s**2
    for window in result.windows:
        np.testing.assert_allclose(window.error["qpos/x"], expected, atol=1e-9)
        np.testing.assert_allclose(window.error["qvel/x"], s, atol=1e-9)
    error = result.signals["qpos/x"]
    assert error.unit == "m"
    assert error.rms == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-6)
    assert error.median == pytest.approx(np.quantile(expected, 0.5), abs=0.01)
    assert error.p95 == pytest.approx(np.quantile(expected, 0.95), abs=0.01)
    assert result.rms == pytest.approx(error.rms, rel=1e-6)
    whole = orbisim.replay(scene, Recording(t, signals), window=0)
    assert whole.windows[0].error["qpos/x"][-1] == pytest.approx(4.5)


def test_overall_is_the_norm_over_joints():
    scene = load_scene(SLIDE)
    t = np.arange(101) * 0.01
    signals = {"qpos/x": 3 * t**2 / 2, "qvel/x": 3 * t, "qpos/y": 4 * t**2 / 2, "qvel/y": 4 * t}
    result = orbisim.replay(scene, Recording(t, signals), window=1.0)
    assert result.rms == pytest.approx(np.sqrt(np.mean((5 * t**2 / 2) ** 2)), rel=1e-6)


def test_recorded_torques_drive_the_joint():
    scene = load_scene(SLIDE)
    t = np.arange(201) * 0.01
    force = np.where(t < 1, 2.0, -1.0)
    x = np.where(t < 1, t**2 / 2, 0.5 + (t - 1) - (t - 1) ** 2 / 4)
    signals = {"qpos/x": x, "qpos/y": 0 * t, "torque/x": force, "qvel/y": 0 * t}
    signals["qvel/x"] = np.where(t < 1, t, 1 - (t - 1) / 2)
    result = orbisim.replay(scene, Recording(t, signals), window=0)
    assert result.rms < 1e-10
    assert any("stands for 'push'" in note for note in result.notes)
    assert "torque/x" not in result.signals


def test_torques_beside_controls_are_compared():
    scene = load_scene(SLIDE.replace('joint="x"', 'joint="x" gear="3"'))
    t = np.arange(101) * 0.01
    signals = {
        "qpos/x": 0.75 * t**2, "qvel/x": 1.5 * t, "qpos/y": 0 * t, "qvel/y": 0 * t,
        "ctrl/push": np.ones(101), "torque/x": np.full(101, 2.5),
    }  # fmt: skip
    result = orbisim.replay(scene, Recording(t, signals), window=0)
    assert result.rms < 1e-10
    error = result.signals["torque/x"]
    assert (error.unit, error.rms) == ("N", pytest.approx(0.5))


def test_servos_are_switched_off_for_recorded_torques():
    scene = load_scene(
        PENDULUM.replace(
            '<motor name="motor" joint="hinge" ctrlrange="-1 1" ctrllimited="true"/>',
            '<position name="servo" joint="hinge" kp="50" kv="1"/>',
        )
    )
    free = load_scene(PENDULUM)
    backend = orbisim.make_backend("mujoco", free)
    t = np.arange(500)
    torque = 0.3 * np.sin(0.02 * t)[:, None]
    trajectory = backend.rollout(backend.reset(1).replace(qpos=np.array([[0.8]])), torque)
    recording = capture(free, trajectory)
    signals = dict(recording.signals)
    signals["torque/hinge"] = signals.pop("ctrl/motor")
    assert orbisim.replay(scene, recording.replace(signals=signals), window=0.4).rms < 1e-9
    with_control = {**signals, "ctrl/servo": 0 * signals["torque/hinge"]}
    assert orbisim.replay(scene, recording.replace(signals=with_control), window=0.4).rms > 0.1


def test_mixed_recordings(scene, recording, trajectory):
    """Several recordings, driven in different ways, in one call."""
    torque = np.array(recording["ctrl/shoulder"])
    forced = recording.without("ctrl/shoulder")
    forced = forced.replace(signals={**forced.signals, "torque/shoulder": torque})
    result = orbisim.replay(scene, [recording, forced, recording.between(0.2, 0.9)], window=0.5)
    assert result.rms < 1e-9
    assert [w.recording for w in result.windows] == [0] * 4 + [1] * 4 + [2]
    assert result.windows[-1].time[0] == pytest.approx(0.2)


def test_divergence_is_counted_and_infinite(scene):
    unstable = load_scene(SLIDE.replace('<joint name="x"', '<joint name="x" stiffness="-1e9"'))
    t = np.arange(101) * 0.01
    signals = {"qpos/x": 1e-3 + 0 * t, "qpos/y": 0 * t, "qvel/x": 0 * t, "qvel/y": 0 * t}
    result = orbisim.replay(unstable, Recording(t, signals), window=0.5)
    assert result.diverged == 2
    assert result.rms == np.inf
    assert result.to_json()["overall"]["rms"] is None
    assert "non-finite in 2 of 2 windows" in result.notes[-1]


# -- backends --------------------------------------------------------------------------------------


class Slow(Backend):
    """A backend with the least that a backend must have, and a long step of its own."""

    name = "slow"

    def load(self, scene):
        self._scene, self.loads = scene, getattr(self, "loads", 0) + 1

    @property
    def timestep(self):
        return 5 * super().timestep

    def reset(self, nworld=None, seed=None):
        count = nworld or self.nworld
        data = mujoco.MjData(self.model)
        sizes = {"qpos": data.qpos, "qvel": data.qvel, "act": data.act}
        return State(time=np.zeros(count), **{n: np.tile(v, (count, 1)) for n, v in sizes.items()})

    def step(self, state, control=None, nstep=1):
        control = self.check_control(state, control)
        after = state.replace(**{n: np.array(getattr(state, n)) for n in ("time", "qpos", "qvel")})
        data = mujoco.MjData(self.model)
        lost = []
        for world in range(state.nworld):
            data.qpos[:], data.qvel[:] = state.qpos[world], state.qvel[world]
            data.ctrl[:] = control[world]
            if data.qpos[0] > 1e3:
                lost.append(world)
            for _ in range(5 * nstep):
                mujoco.mj_step(self.model, data)
            after.qpos[world], after.qvel[world] = data.qpos, data.qvel
            after.time[world] += nstep * self.timestep
        if lost:
            raise DivergedError("far away", lost)
        return after


def test_any_backend_will_do(scene, recording):
    backend = Slow()
    free = recording.replace(
        signals={n: v for n, v in recording.signals.items() if not n.startswith("ctrl")}
    )
    a = orbisim.replay(scene, free, backend=backend, window=0.5)
    b = orbisim.replay(scene, free, window=0.5)
    assert backend.loads == 1
    assert a.backend == "slow"
    for x, y in zip(a.windows, b.windows, strict=True):
        np.testing.assert_allclose(x.qpos[::5], y.qpos[::5], atol=1e-9)  # on the backend's steps
        assert np.abs(x.qpos - y.qpos).max() < 2e-2  # between them
    assert a.signals["sensor/encoder"].rms == pytest.approx(
        b.signals["sensor/encoder"].rms, rel=0.1
    )
    assert np.isnan(a.signals["sensor/imu"].rms)  # nobody but the backend knows accelerations


def test_forces_need_a_backend_that_takes_them(scene, recording):
    forced = recording.without("ctrl/shoulder")
    signals = {**forced.signals, "torque/shoulder": recording["ctrl/shoulder"]}
    assert Capability.CLASSICAL not in Slow.capabilities
    with pytest.raises(InputError, match="'slow' does not take recorded joint forces"):
        orbisim.replay(scene, forced.replace(signals=signals), backend=Slow())


def test_divergence_on_any_backend():
    unstable = load_scene(SLIDE.replace('<joint name="x"', '<joint name="x" stiffness="-1e3"'))
    t = np.arange(301) * 0.01
    signals = {"qpos/x": 0.1 + 0 * t, "qpos/y": 0 * t, "qvel/x": 0 * t, "qvel/y": 0 * t}
    result = orbisim.replay(unstable, Recording(t, signals), backend=Slow(), window=1.5)
    assert result.diverged == 2


DELAYED = """
<mujoco><option timestep="0.002"/><worldbody>
  <body><joint name="j" axis="0 1 0"/><geom size=".1" pos="0 0 -.3"/></body>
</worldbody>
<actuator><motor name="late" joint="j" delay="0.02" nsample="15"/></actuator>
<sensor><jointpos name="late" joint="j" delay="0.03" nsample="20"/></sensor></mujoco>
"""


def test_delays_start_in_the_middle():
    scene = load_scene(DELAYED)
    backend = orbisim.make_backend("mujoco", scene)
    rng = np.random.default_rng(0)
    controls = rng.standard_normal((1000, 1))
    controls[0] = 0  # before the first sample, the first control is taken to have acted
    trajectory = backend.rollout(backend.reset(1), controls)
    recording = capture(scene, trajectory)
    torque = {"torque/j": np.zeros(len(recording))}
    recording = recording.replace(signals={**recording.signals, **torque})
    result = orbisim.replay(scene, recording, window=0.5)
    assert result.rms < 1e-12
    sensor = [window.error["sensor/late"] for window in result.windows]
    assert all(np.isnan(error[:15]).all() for error in sensor)
    assert all(np.nanmax(error) < 1e-12 for error in sensor)
    assert np.isnan(result.signals["torque/j"].rms)


def test_warp(scene, recording):
    pytest.importorskip("mujoco_warp")
    a = orbisim.replay(scene, recording, backend="warp", device="cpu", window=0.25)
    assert a.backend == "warp"
    assert a.rms < 1e-3
    assert a.signals["sensor/imu"].rms < 0.5


def test_long_rollouts_are_cut_into_pieces(scene, recording, monkeypatch):
    monkeypatch.setattr("orbisim.freerun.batch._NUMBERS", 3000)
    monkeypatch.setattr("orbisim.freerun.run.WORLDS", 3)
    parts = [recording, recording.between(0.3, 1.1), recording.between(0.0, 0.4)]
    result = orbisim.replay(scene, parts, window=0)
    assert result.rms < 1e-11
    assert result.signals["sensor/imu"].rms < 1e-9
    assert [len(w.time) for w in result.windows] == [len(p) for p in parts]


# -- input and output ------------------------------------------------------------------------------


def test_json_is_the_contract(tmp_path, recording):
    (tmp_path / "scene.xml").write_text(EVERYTHING)
    recording.save(tmp_path / "a.npz")
    recording.save(tmp_path / "b.csv")
    result = orbisim.replay(
        tmp_path / "scene.xml", [str(tmp_path / "a.npz"), tmp_path / "b.csv"], window=0.5
    )
    assert isinstance(result, Replay)
    found = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert list(found) == [
        "schema", "scene", "backend", "window_s", "windows", "signals", "overall",
    ]  # fmt: skip
    assert found["schema"] == "orbisim.replay/1"
    assert found["scene"] == str(tmp_path / "scene.xml")
    assert found["backend"] == "mujoco"
    assert found["window_s"] == 0.5
    assert found["windows"] == 8
    assert set(found["signals"]["qpos/elbow"]) == {"unit", "rms", "median", "p95", "noise"}
    units = {name: entry["unit"] for name, entry in found["signals"].items()}
    assert units["qpos/elbow"] == units["xquat/cube"] == units["qpos/socket"] == "rad"
    assert units["qvel/rail"] == units["qvel/cube[0:3]"] == "m/s"
    assert units["sensor/imu"] == "m/s^2"
    assert set(found["overall"]) == {"rms"}
    assert result.recordings == (str(tmp_path / "a.npz"), str(tmp_path / "b.csv"))


@pytest.mark.parametrize(
    ("factor", "window", "message"),
    [
        (1e3, 0.5, "samples are 2 s apart|holds two samples: they are 2 s apart"),
        (1e6, 0.5, "timesteps of the scene; time is in seconds"),
        (1e6, 0.0, "timesteps of the scene; time is in seconds"),
        (1e12, 0.5, "timesteps of the scene; time is in seconds"),
    ],
)
def test_time_in_other_units(scene, recording, factor, window, message):
    """Windows are as many as samples at most, not as time has half seconds."""
    scaled = recording.replace(time=recording.time * factor)
    with pytest.raises(RecordingError, match=message):
        orbisim.replay(scene, scaled, window=window)


def test_wrong_arguments(scene, recording):
    with pytest.raises(InputError, match="at least one recording"):
        orbisim.replay(scene, [])
    with pytest.raises(InputError, match="a window lasts"):
        orbisim.replay(scene, recording, window=-1)
    with pytest.raises(InputError, match="'recorded' or 'smoothed'"):
        orbisim.replay(scene, recording, velocities="guessed")
    pieces = {n: np.array(v) for n, v in recording.signals.items()}
    pieces["qpos/elbow"][:600] = np.nan
    pieces["qpos/shoulder"][400:] = np.nan
    with pytest.raises(RecordingError, match="no window can start: at no sample are all joint"):
        orbisim.replay(scene, recording.replace(signals=pieces))
    pieces["qpos/shoulder"][1:] = np.nan
    del pieces["qvel/shoulder"]  # one position says nothing about the velocity
    with pytest.raises(RecordingError, match="position and velocity of 'shoulder' known"):
        orbisim.replay(scene, recording.replace(signals=pieces))


def test_the_function_is_reached_in_every_way():
    lines = [
        "import orbisim, sys; f = orbisim.replay; assert 'torch' not in sys.modules; "
        "import orbisim.replay; assert orbisim.replay is f",
        "from orbisim.replay import Replay; import orbisim; assert callable(orbisim.replay)",
    ]
    for line in lines:
        subprocess.run([sys.executable, "-c", line], check=True)
