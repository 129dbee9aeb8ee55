"""Tasks as scenes: by name, compared, under another backend."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Physics, load_scene, make_backend, tasks
from orbisim.episodes import episodes
from orbisim.errors import UnknownNameError
from orbisim.tasks import available
from orbisim.tasks.base import Scripted


@pytest.mark.parametrize("name", available())
def test_every_task_is_a_scene(name: str) -> None:
    scene = load_scene(f"task:{name}")
    assert scene.source == f"task:{name}"
    assert scene.editable
    assert not scene.warnings


def test_a_subtask_can_be_named() -> None:
    assert load_scene("task:push-to_hit").name == "push"
    with pytest.raises(UnknownNameError, match="did you mean 'to_hit'"):
        load_scene("task:push-to_hurt")


def test_trials_carry_the_policys_controls() -> None:
    setup = episodes("task:push", 2, seed=1)
    assert isinstance(setup, Scripted)
    fine = setup.controls(5.0, 0.002, 0)
    coarse = setup.controls(5.0, 0.05, 0)
    assert fine.shape == (2, 2500, 7)
    np.testing.assert_array_equal(fine[:, ::25], coarse)
    backend = make_backend("mujoco", setup.scene, nworld=2)
    end = backend.rollout(setup.initial, coarse, nstep=25).qpos[:, -1]
    start = setup.initial.qpos
    assert (np.linalg.norm(end[:, 15:17] - start[:, 15:17], axis=1) > 0.05).all()


@pytest.mark.parametrize("name", ["ball", "toss"])
def test_passive_trials(name: str) -> None:
    setup = episodes(f"task:{name}", 3, seed=0)
    assert setup.controls(0.1, 0.01, 0).shape == (3, 10, 0)
    assert len(np.unique(setup.initial.qvel[:, 0])) == 3


def test_physics_runs_a_task() -> None:
    physics = Physics.from_scene(tasks.make("push").scene("to_hit", 4))
    physics.step(10)
    assert np.isfinite(physics.data.qpos).all()


@pytest.mark.slow  # compiles its kernels for half a minute
def test_warp_follows_mujoco_on_push() -> None:
    pytest.importorskip("mujoco_warp")
    setup = episodes("task:push", 1, seed=1)
    control = setup.controls(0.5, 0.05, 0)
    ends = [
        make_backend(name, setup.scene).rollout(setup.initial, control, nstep=25).qpos[0, -1]
        for name in ("mujoco", "warp")
    ]
    np.testing.assert_allclose(ends[1][:6], ends[0][:6], atol=1e-3)
    np.testing.assert_allclose(ends[1][8:11], ends[0][8:11], atol=1e-3)
