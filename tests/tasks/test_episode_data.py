"""What is in an episode: views, descriptors, replay."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import make_backend, tasks
from orbisim.scene import matrices
from orbisim.state import State
from orbisim.tasks.episode import Episode
from orbisim.tasks.sampling import episode_seed

CASES = [
    ("push", "to_hit"),
    ("push_cubes", "stacked"),
    ("pick_and_place", "stack"),
    ("ball", "throw"),
    ("toss", "box"),
    ("suite:cheetah-run", "smooth"),
    ("suite:reacher-easy", "feedback"),
]


@pytest.fixture(scope="module", params=CASES, ids=[f"{a}-{b}" for a, b in CASES])
def case(request: pytest.FixtureRequest) -> tuple[tasks.Task, Episode]:
    name, subtask = request.param
    task = tasks.make(name)
    return task, task.episode(subtask, 3)


def test_the_same_arguments_give_the_same_bytes(case: tuple[tasks.Task, Episode]) -> None:
    task, episode = case
    task.episode(episode.subtask, 4)  # whatever it leaves behind must not matter
    again = task.episode(episode.subtask, 3)
    assert again.scene_hash == episode.scene_hash
    assert again.arrays.keys() == episode.arrays.keys()
    for name, array in episode.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], array, err_msg=name)


def test_another_seed_gives_another_episode(case: tuple[tasks.Task, Episode]) -> None:
    task, episode = case
    assert not np.array_equal(task.episode(episode.subtask, 4).arrays["qpos"][0], 0)
    assert not np.array_equal(
        task.episode(episode.subtask, 4).arrays["qvel"][-1], episode.arrays["qvel"][-1]
    )


def test_everything_is_finite_and_quaternions_are_unit(case: tuple[tasks.Task, Episode]) -> None:
    _, episode = case
    for name, array in episode.arrays.items():
        if array.dtype.kind == "f":
            assert np.isfinite(array).all(), name
    quats = episode.arrays["objects/quat"]
    np.testing.assert_allclose(np.linalg.norm(quats, axis=-1), 1.0, atol=1e-5)
    assert (np.sum(quats[1:] * quats[:-1], axis=-1) > 0).all()


def test_the_scene_of_an_episode_can_be_made_again(case: tuple[tasks.Task, Episode]) -> None:
    task, episode = case
    assert task.scene(episode.subtask, 3).fingerprint == episode.scene_hash


def test_descriptors_equal_the_compiled_model(case: tuple[tasks.Task, Episode]) -> None:
    task, episode = case
    model = task.scene(episode.subtask, 3).model
    names = [n.decode() for n in episode.arrays["entities/names"] if n != b"robot"]
    rows = episode.arrays["descriptor/objects"]
    column = {name: i for i, name in enumerate(matrices.OBJECT_COLUMNS)}
    assert rows.shape == (len(names), len(column))
    for name, row in zip(names, rows, strict=True):
        body = model.body(name)
        assert row[column["mass"]] == body.mass[0]
        np.testing.assert_array_equal(row[4:7], body.inertia)
        geom = matrices.main_geom(model, body.id)
        if geom is not None and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            np.testing.assert_allclose(row[:3], model.geom_size[geom])
            assert row[column["type_box"]] == 1.0
            assert row[column["friction_slide"]] == model.geom_friction[geom, 0]
    world = dict(zip(matrices.WORLD_COLUMNS, episode.arrays["descriptor/world"], strict=True))
    assert world["gravity_z"] == model.opt.gravity[2]
    assert world["control_timestep"] == task.control_timestep


def test_views_agree_with_forward_kinematics(case: tuple[tasks.Task, Episode]) -> None:
    task, episode = case
    model = task.scene(episode.subtask, 3).model
    data = mujoco.MjData(model)
    names = [n.decode() for n in episode.arrays["entities/names"] if n != b"robot"]
    for t in (0, episode.steps // 2, episode.steps):
        data.qpos[:], data.qvel[:] = (episode.arrays[n][t] for n in ("qpos", "qvel"))
        mujoco.mj_forward(model, data)
        for i, name in enumerate(names):
            np.testing.assert_allclose(
                episode.arrays["objects/pos"][t, i], data.body(name).xpos, atol=1e-5
            )
            rotation = np.empty(9)
            quat = episode.arrays["objects/quat"][t, i].astype(float)
            mujoco.mju_quat2Mat(rotation, quat)
            np.testing.assert_allclose(rotation, data.body(name).xmat, atol=1e-5)


def test_velocities_of_free_bodies_are_in_the_world_frame() -> None:
    episode = tasks.make("toss").episode("box", 11)
    dt = tasks.make("toss").control_timestep
    pos, linvel = episode.arrays["objects/pos"][:, 0], episode.arrays["objects/linvel"][:, 0]
    early = slice(0, 4)  # before the first contact
    slopes = np.diff(pos, axis=0)[early] / dt
    np.testing.assert_allclose(slopes, (linvel[:-1] + linvel[1:])[early] / 2, atol=0.01)
    quats = episode.arrays["objects/quat"][:, 0].astype(float)
    spin = episode.arrays["objects/angvel"][0, 0]
    for t in range(3):
        inverse, turn, rate = np.empty(4), np.empty(4), np.empty(3)
        mujoco.mju_negQuat(inverse, quats[t])
        mujoco.mju_mulQuat(turn, quats[t + 1], inverse)  # in the world frame
        mujoco.mju_quat2Vel(rate, turn, dt)
        assert np.linalg.norm(rate - episode.arrays["objects/angvel"][t, 0]) < 0.1 + 0.05 * float(
            np.linalg.norm(spin)
        )


@pytest.mark.parametrize(("name", "subtask"), [("push", "to_hit"), ("suite:walker-walk", "held")])
def test_controls_replay_the_episode(name: str, subtask: str) -> None:
    task = tasks.make(name)
    episode = task.episode(subtask, 2)
    scene = task.scene(subtask, 2)
    backend = make_backend("mujoco", scene)
    arrays = episode.arrays
    state = State(
        time=np.zeros(1), qpos=arrays["qpos"][:1], qvel=arrays["qvel"][:1], act=arrays["act"][:1]
    )
    nstep = round(task.control_timestep / scene.model.opt.timestep)
    trajectory = backend.rollout(state, arrays["ctrl"][None, :20], nstep=nstep)
    np.testing.assert_allclose(trajectory.qpos[0], arrays["qpos"][1:21], atol=1e-8)


def test_toss_keeps_energy_and_momentum_in_flight() -> None:
    task = tasks.make("toss", clearance=0.15, vertical=0.6)
    episode = task.episode("box", 1)
    model = task.scene("box", 1).model
    data = mujoco.MjData(model)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    energies = []
    for t in range(8):
        data.qpos[:], data.qvel[:] = (episode.arrays[n][t] for n in ("qpos", "qvel"))
        mujoco.mj_forward(model, data)
        assert data.ncon == 0
        energies.append(data.energy.sum())
    np.testing.assert_allclose(energies, energies[0], rtol=2e-3)
    np.testing.assert_allclose(
        episode.arrays["qvel"][:8, :2], np.tile(episode.arrays["qvel"][0, :2], (8, 1)), atol=1e-9
    )


def test_seeds_of_episodes_do_not_depend_on_the_size_of_the_collection() -> None:
    assert episode_seed(0, "task:push", "to_hit", 7) == episode_seed(0, "task:push", "to_hit", 7)
    seeds = {episode_seed(s, "task:push", t, i) for s in (0, 1) for t in "ab" for i in range(50)}
    assert len(seeds) == 200
