"""Windows simulated side by side are those simulated one by one."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Recording, Scene, load_scene, make_backend
from orbisim.backend import Backend
from orbisim.errors import DivergedError
from orbisim.freerun import batch
from orbisim.freerun.batch import Batch
from orbisim.freerun.jobs import Job
from orbisim.recording import bind, capture
from orbisim.recording.zero_order_hold import Held
from orbisim.replay import prepare
from orbisim.state import State
from tests.recording.scenes import EVERYTHING, simulate


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(EVERYTHING)


def jobs_of(scene: Scene, window: float, force: np.ndarray | None = None) -> list[Job]:
    recording = capture(scene, simulate(scene, 120), rate=300.0)
    one = prepare(bind(recording, scene), window)
    held = None if force is None else Held(one.bound.time, np.tile(force, (len(recording), 1)))
    ctrl = Held(one.bound.time, one.bound.ctrl)
    return [Job(0, rows, one, ctrl, held) for rows in one.windows]


def test_jobs_know_their_times(scene: Scene) -> None:
    jobs = jobs_of(scene, 0.05)
    assert len(jobs) == 4
    assert jobs[1].duration == pytest.approx(0.05, abs=0.004)
    assert jobs[1].time[0] == pytest.approx(0.05, abs=0.004)
    assert len(jobs[1].time) == len(jobs[1].rows)


@pytest.mark.parametrize("numbers", [8_000_000, 1, 300])
def test_neither_company_nor_pieces_change_a_window(
    scene: Scene, numbers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "_NUMBERS", numbers)
    jobs = [*jobs_of(scene, 0.05), *jobs_of(scene, 0.02)]
    backend = make_backend("mujoco", scene)
    together = Batch(backend, jobs).run()
    for job, found in zip(jobs, together, strict=True):
        (alone,) = Batch(backend, [job]).run()
        assert found.rows == alone.rows
        for name in ("time", "qpos", "qvel", "act", "sensordata"):
            np.testing.assert_array_equal(getattr(found, name), getattr(alone, name), err_msg=name)
        assert np.isfinite(found.qpos).all()


def test_the_first_sample_is_the_recorded_state(scene: Scene) -> None:
    for job, found in zip(
        jobs := jobs_of(scene, 0.05), Batch(make_backend("mujoco", scene), jobs).run(), strict=True
    ):
        np.testing.assert_array_equal(found.qpos[0], job.prepared.states.qpos[job.rows.start])


def test_recorded_forces_act_at_every_step(scene: Scene) -> None:
    """As MuJoCo's own qfrc_applied."""
    force = np.zeros(scene.model.nv)
    force[-1] = 3.0
    jobs = jobs_of(scene, 0.1, force)[:1]
    (found,) = Batch(make_backend("mujoco", scene), jobs).run()
    (without,) = Batch(make_backend("mujoco", scene), jobs_of(scene, 0.1)[:1]).run()
    moved = found.qpos[-1, -1] - without.qpos[-1, -1]
    mass = scene.model.body("drawer").mass[0]
    assert moved == pytest.approx(0.5 * 3.0 / mass * jobs[0].duration ** 2, rel=0.05)
    np.testing.assert_allclose(found.qpos[:, :2], without.qpos[:, :2], atol=1e-12)


class Fragile(Backend):
    """Stands still, and loses a world when its clock passes 0.061 s."""

    name = "fragile"

    def load(self, scene: Scene) -> None:
        self._scene = scene

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        return make_backend("mujoco", self.scene).reset(nworld or self.nworld)

    def step(self, state: State, control: object = None, nstep: int = 1) -> State:
        time = state.time + nstep * self.timestep
        lost = np.flatnonzero(time > 0.061)
        if lost.size:
            raise DivergedError("fragile", lost.tolist())
        return state.replace(time=time)


def test_a_lost_window_stays_lost_and_costs_no_other(scene: Scene) -> None:
    time = 0.002 * np.arange(60)
    recording = Recording(time, {"qpos": np.tile(scene.model.qpos0, (60, 1))})
    one = prepare(bind(recording, scene), 0.04)
    backend = Fragile()
    backend.load(scene)
    ctrl = Held(time, one.bound.ctrl)
    runs = Batch(backend, [Job(0, rows, one, ctrl, None) for rows in one.windows]).run()
    assert [run.diverged for run in runs] == [False, True, True]
    lost = np.isnan(runs[1].qpos).any(axis=1)
    assert np.array_equal(lost, runs[1].time > 0.061)
