"""Windows of recordings simulated from their recorded states, whatever order they are run in."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Recording, Scene, load_scene, make_backend
from orbisim.freerun import run
from orbisim.freerun.run import free_run
from orbisim.recording import bind, capture
from orbisim.replay import prepare
from orbisim.trajectory import Trajectory
from tests.recording.scenes import PENDULUM, simulate


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(PENDULUM)


@pytest.fixture(scope="module")
def trajectory(scene: Scene) -> Trajectory:
    return simulate(scene, 300)


@pytest.mark.parametrize("worlds", [256, 2])
def test_runs_come_in_the_order_of_their_windows(
    scene: Scene, trajectory: Trajectory, worlds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of several recordings with windows of different lengths, simulated in groups."""
    monkeypatch.setattr(run, "WORLDS", worlds)
    bound = bind(capture(scene, trajectory), scene)
    both = [prepare(bound, 0.25), prepare(bound, 0.1)]
    runs = free_run(make_backend("mujoco", scene), scene, both)
    expected = [(i, rows) for i, one in enumerate(both) for rows in one.windows]
    assert [(found.recording, found.rows) for found in runs] == expected
    for found in runs:
        rows = slice(found.rows.start, found.rows.stop)
        np.testing.assert_array_equal(found.time, both[found.recording].bound.time[rows])
        np.testing.assert_allclose(found.qpos, both[found.recording].bound.qpos[rows], atol=1e-10)
        assert not found.diverged


def test_the_backend_has_the_scene_again_when_motors_were_switched_off(
    scene: Scene, trajectory: Trajectory
) -> None:
    """A recorded torque drives the joint in the motor's place."""
    recording = capture(scene, trajectory)
    torque = {"torque/hinge": 0.2 * np.sin(np.arange(len(recording)) / 30)}
    kept = {name: recording[name] for name in recording.signals if not name.startswith("ctrl")}
    driven = prepare(bind(Recording(recording.time, kept | torque), scene), 0.2)
    assert driven.bound.switched_off == (0,)
    backend = make_backend("mujoco", scene)
    free_run(backend, scene, [driven])
    assert backend.scene is scene
    assert backend.model.actuator_gainprm[0, 0] == 1.0


def test_actuators_that_are_switched_off_exert_no_force(scene: Scene) -> None:
    off = run._without_actuators(scene, (0,))
    backend = make_backend("mujoco", off)
    state = backend.reset()
    driven, left = (backend.step(state, np.full(1, c), 20).qvel for c in (1.0, 0.0))
    np.testing.assert_array_equal(driven, left)
    assert run._without_actuators(scene, ()) is scene
    assert scene.model.actuator_gainprm[0, 0] == 1.0
