"""Initial states from the whole range of a mechanism."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim import tasks
from orbisim.tasks.suite_states import spread_out


def test_states_cover_the_range_of_the_joints() -> None:
    task = tasks.make("suite:cheetah-run", steps=1, spread=1.0)
    starts = np.array([task.episode("smooth", i).arrays["qpos"][0] for i in range(40)])
    model = task.scene().model
    low, high = model.jnt_range[3:].T
    covered = (starts[:, 3:].max(0) - starts[:, 3:].min(0)) / (high - low)
    assert (covered > 0.8).all()
    assert np.ptp(starts[:, 2]) > 4.0  # the torso, all the way round


def drawn(body: str, floor: str = "", seed: int = 0) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{floor}{body}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    spread_out(model, data, np.random.default_rng(seed))
    return model, data


FLOOR = "<geom type='plane' size='9 9 .1'/>"


def test_what_is_in_the_floor_is_lifted_onto_it() -> None:
    root = (
        "<body><joint type='slide' axis='0 0 1'/><joint type='hinge' axis='0 1 0'/>"
        "<geom type='capsule' size='.1' fromto='-1 0 0 1 0 0'/></body>"
    )
    for seed in range(10):
        _, data = drawn(root, FLOOR, seed)
        depth = min((c.dist for c in data.contact), default=0.0)
        assert depth >= -0.002
        assert data.qpos[0] <= 1.2  # and no higher


def test_what_cannot_be_freed_stays_where_it_was() -> None:
    stuck = "<body><joint type='hinge' axis='0 0 1'/><geom size='.5'/></body>"
    _, data = drawn(stuck, FLOOR)
    assert data.qpos[0] == 0.0
    assert data.qvel[0] == 0.0


def test_ranges_are_kept() -> None:
    limited = (
        "<body><joint range='10 20'/><joint type='slide' range='.1 .2'/><geom size='.1'/></body>"
    )
    for seed in range(20):
        model, data = drawn(limited, seed=seed)
        low, high = model.jnt_range.T
        assert (data.qpos >= low).all()
        assert (data.qpos <= high).all()
