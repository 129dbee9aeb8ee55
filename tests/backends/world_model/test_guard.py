"""Worlds that diverge, and states that were never seen."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.guard import Guard, blanked
from orbisim_world_model.reading import read_layout
from orbisim_world_model.reading_articulation import natural_step, read_articulated

from orbisim import load_scene
from tests.backends.world_model.synthetic import TABLE, simulate

RANGES = {
    "joint_speed": 2.0,
    "object_speed": 3.0,
    "object_turning": 4.0,
    "joints": {"x": [-0.4, 0.4], "y": [-0.4, 0.4]},
    "object_position": {"x": [-0.5, 0.5], "y": [-0.5, 0.5], "z": [0.03, 0.05]},
}


@pytest.fixture(scope="module")
def guard() -> Guard:
    layout = read_layout(mujoco.MjModel.from_xml_string(TABLE), 0.02)
    return Guard({"ranges": RANGES}, layout)


@pytest.fixture(scope="module")
def states():  # type: ignore[no-untyped-def]
    pack = simulate(TABLE, 1, 11, 4)
    x = pack.states(torch.arange(12))
    return type(x)(*(field.reshape(4, 3, *field.shape[1:]) for field in x))


def test_the_first_state_that_is_lost(guard: Guard, states) -> None:  # type: ignore[no-untyped-def]
    start = states.at(0)
    assert guard.watch(states, start).diverged_at.tolist() == [-1, -1, -1]
    pos, v = states.pos.clone(), states.v.clone()
    pos[2:, 1, 1] = torch.nan
    v[1, 2] = 10 * 2.0 + 1
    notice = guard.watch(states._replace(pos=pos, v=v), start)
    found = notice.diverged_at
    assert found.tolist() == [-1, 2, 1]
    assert [guard.names[i] for i in notice.entity[1:]] == [guard.names[2], "robot"]
    assert notice.outside_at[1, 2] == 2 and notice.outside_at[2, 0] == 1
    gone = blanked(states, found)
    assert torch.isnan(gone.q[2:, 1]).all()
    assert torch.isnan(gone.pos[1:, 2]).all()
    assert torch.equal(gone.q[:, 0], states.q[:, 0])
    assert torch.equal(gone.q[:2, 1], states.q[:2, 1])


def test_what_began_beyond_a_bound_may_stay_there(guard: Guard, states) -> None:  # type: ignore[no-untyped-def]
    x = states.at(0)
    fast = x._replace(vel=x.vel + 40.0)
    assert guard.lost(fast, x)[..., 1:].all() and not guard.lost(fast, fast)[..., 1:].any()
    high = x._replace(pos=x.pos + torch.tensor([0.0, 0.0, 50.0]))
    assert guard.lost(high, x)[..., 1:].all() and not guard.lost(high, high)[..., 1:].any()
    higher = x._replace(pos=x.pos + torch.tensor([0.0, 0.0, 60.0]))
    assert guard.lost(higher, high)[..., 1:].all()


def test_joints_have_the_limits_of_the_scene(states) -> None:  # type: ignore[no-untyped-def]
    model = mujoco.MjModel.from_xml_string(TABLE)
    guard = Guard({"ranges": RANGES}, read_layout(model, 0.02), model)
    x = states.at(0)
    for q, lost in ((0.55, False), (0.65, True), (-0.65, True)):  # of a range of -0.5 to 0.5
        moved = x._replace(q=torch.full_like(x.q, q))
        assert guard.lost(moved, x)[:, 0].tolist() == [lost] * 3


def test_one_worlds_coordinates(guard: Guard, states) -> None:  # type: ignore[no-untyped-def]
    x = states.at(0).at(slice(0, 1))
    x = x._replace(pos=torch.tensor([[[0.1, 0.1, 0.04], [-0.1, 0.1, 0.04]]]))
    qpos, qvel, act = (array.numpy() for array in guard.layout.join(x))
    assert guard.calm(qpos, qvel, act)
    for bad in (np.nan, 1e4, 0.6):
        moved = qpos.copy()
        moved[0, 0] = bad
        assert not guard.calm(moved, qvel, act)
    assert not guard.calm(qpos, np.full_like(qvel, 401.0), act)


def test_activations_count_too(states) -> None:  # type: ignore[no-untyped-def]
    filtered = '<general joint="x" dyntype="filter" dynprm="0.1"/>'
    model = mujoco.MjModel.from_xml_string(TABLE.replace("</actuator>", f"{filtered}</actuator>"))
    guard = Guard({"ranges": RANGES}, read_layout(model, 0.02), model)
    qpos, qvel = np.zeros((1, model.nq)), np.zeros((1, model.nv))
    qpos[:, [4, 11]], qpos[:, [5, 12]] = 0.04, 1.0
    for act in (0.3, 1e4, -1e4, np.inf, np.nan):
        x = states.at(0)._replace(act=torch.full((3, 1), act))
        lost = bool(guard.lost(x, x)[:, 0].any())
        assert guard.calm(qpos, qvel, np.full((1, 1), act)) is not lost, act
        assert lost is (act != 0.3)


def test_what_lies_outside_is_named(guard: Guard, states) -> None:  # type: ignore[no-untyped-def]
    x = states.at(0)
    calm = x._replace(
        q=0 * x.q, v=0 * x.v, vel=0 * x.vel, ang=0 * x.ang,
        pos=torch.tensor([0.0, 0.0, 0.04]).expand_as(x.pos),
    )  # fmt: skip
    assert guard.concerns(calm) == []
    (joint,) = guard.concerns(calm._replace(q=calm.q + torch.tensor([0.5, 0.0])))
    assert joint == "joint 'x' is at 0.5 (trained on -0.4 to 0.4)"
    (high,) = guard.concerns(calm._replace(pos=calm.pos + torch.tensor([0.0, 0.0, 0.1])))
    assert high == "an object's z is at 0.14 (trained on 0.03 to 0.05)"
    (fast,) = guard.concerns(calm._replace(vel=calm.vel + 7.0))
    assert fast == "object speed is 7 (trained up to 3)"


@pytest.mark.parametrize("task", ["walker-walk", "hopper-hop", "cheetah-run"])
def test_limbs_that_motors_push_past_their_limits_are_not_lost(task: str) -> None:
    """Data of one robot know how far its soft limits give; those of many say nothing of it."""
    model = load_scene(f"suite:{task}").model
    layout = read_articulated(model, natural_step(model))
    ranges = {"joint_speed": 75.0, "object_speed": 0.0, "object_turning": 0.0}
    guard = Guard({"ranges": {**ranges, "joints": {}, "object_position": {}}}, layout, model)
    rng, data, rows = np.random.default_rng(0), mujoco.MjData(model), []
    for number in range(4_000):
        if number % 100 == 0:
            data.ctrl[:] = rng.choice([-1.0, 1.0], model.nu)
        mujoco.mj_step(model, data)
        rows.append((data.qpos.copy(), data.qvel.copy()))
    qpos, qvel = (torch.as_tensor(np.array(part)).float() for part in zip(*rows, strict=True))
    x = layout.split(qpos, qvel, torch.zeros(len(rows), 0))
    limited = model.jnt_limited.astype(bool)
    low, high = model.jnt_range[limited].T
    past = np.maximum(low - qpos.numpy()[:, limited], qpos.numpy()[:, limited] - high)
    assert (past / (high - low)).max() > 0.1
    assert not guard.lost(x, x.at(slice(0, 1))).any()
    far = x._replace(q=x.q + 0.5 * float((high - low).max()) + torch.pi)
    assert guard.lost(far, x.at(slice(0, 1))).all()
