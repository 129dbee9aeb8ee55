"""Four machines and what policies are to do with them."""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

from orbisim_policies.problem import Moment
from orbisim_policies.true import TrueWorlds
from paying.cart import MOST, Balance
from paying.conditions import DUTIES, machine
from paying.duty import SCENES, Duty
from paying.hop import Hop
from paying.reach import Reach, hand
from paying.shove import STRIDE, Shove

EVERY = list(DUTIES.values())


@pytest.mark.parametrize("kind", EVERY)
def test_a_duty_is_the_same_in_every_scene_of_its_machine(kind: type[Duty]) -> None:
    places = [kind(), kind(machine(kind)), kind(seed=1)]
    drawn = [place.draw([3, 4]) for place in places]
    for place, starts in zip(places, drawn, strict=True):
        qpos, qvel = (torch.as_tensor(f).float() for f in (starts.qpos, starts.qvel))
        command = torch.as_tensor(starts.command).float()
        np.testing.assert_array_equal(starts.command, drawn[0].command)
        np.testing.assert_array_equal(starts.qpos[:, place.q], drawn[0].qpos)
        score = place.begin(qpos, qvel, command)
        params = torch.as_tensor(starts.params).float()
        moment = Moment(qpos, qvel, command, params, score, torch.zeros(2))
        assert place.observe(moment).shape == (2, place.observations)
        control, after = place.control(command, torch.zeros(2, place.actions))
        assert control.shape == (2, place.scene.model.nu) and after.shape == command.shape
        score = place.count(score, qpos, qvel, control)
        value = place.value(score, qpos)
        assert value.shape == (2, 1) and bool((value <= 1).all())
        found = place.success(starts, starts.qpos, value.double().numpy())
        assert found["success"].shape == (2,)
    assert places[1].scene.fingerprint != places[0].scene.fingerprint


@pytest.mark.parametrize("kind", EVERY)
def test_what_is_drawn_widely_contains_the_machine(kind: type[Duty]) -> None:
    ranges = {(one.effect, one.target): one.ranges for one in kind.wide}
    for effect in kind.effects:
        for name, (low, high) in ranges[effect.effect, effect.target].items():
            assert low <= effect.values[name] <= high


def test_drawn_episodes_are_in_scenes_of_their_own() -> None:
    place = Shove(seed=0)
    seen, number = set(), place.scene.model.geom("box").id
    working = copy.copy(place.scene.model)
    for scene in range(SCENES):
        place.write(working, np.array([float(scene)]))
        seen.add(float(working.geom_friction[number, 0]))
        assert 0.1 <= working.geom_friction[number, 0] <= 1.2
    assert len(seen) == SCENES


def test_the_pole_that_stands_is_balanced_and_the_one_that_hangs_is_not() -> None:
    place = Balance()
    starts = place.draw([1, 1, 1])
    ends = np.array([[0.0, np.pi], [0.0, 0.0], [2.0, -np.pi]])
    found = place.success(starts, ends, np.zeros((3, 1)))
    assert found["success"].tolist() == [True, False, False]
    control, after = place.control(torch.zeros(1, 8), torch.tensor([[0.5]]))
    assert float(control) == 0.5 * MOST and float(after[0, 0]) == 0.5


def test_the_hand_is_where_mujoco_has_it() -> None:
    place, rng = Reach(), np.random.default_rng(0)
    data = mujoco.MjData(place.scene.model)
    data.qpos[:] = rng.uniform(-1, 1, 2)
    mujoco.mj_forward(place.scene.model, data)
    body = data.body("forearm")
    end = body.xpos + body.xmat.reshape(3, 3) @ [0, 0, -0.25]
    found = hand(torch.tensor(data.qpos)[None])[0]
    np.testing.assert_allclose(found, end[[0, 2]], atol=1e-12)


def test_a_shove_moves_the_hand_and_a_box_in_its_place_is_good() -> None:
    place = Shove()
    starts = place.draw([1, 2])
    control, after = place.control(torch.tensor(starts.command), torch.tensor([[1.0], [-1.0]]))
    np.testing.assert_allclose(control[:, 0], [STRIDE, -STRIDE])
    np.testing.assert_array_equal(after[:, 1], starts.command[:, 1])
    ends = starts.qpos.copy()
    ends[0, 2] = starts.command[0, 1] - 0.01
    assert place.success(starts, ends, np.zeros((2, 1)))["success"].tolist() == [True, False]


def test_a_hop_is_as_high_as_its_highest_point() -> None:
    place = Hop()
    starts = place.draw([1])
    qpos, qvel = torch.tensor(starts.qpos), torch.tensor(starts.qvel)
    score = place.begin(qpos, qvel, torch.tensor(starts.command))
    for off in (-0.1, -0.02, -0.2):
        qpos[:, 0] = starts.command[0, 1] + off
        score = place.count(score, qpos, qvel, torch.zeros(1, 2))
    value = place.value(score, qpos).numpy()
    assert place.missed(starts, qpos.numpy(), value)[0] == pytest.approx(20.0, abs=1e-6)
    assert not place.success(starts, qpos.numpy(), value)["success"][0]


def test_the_machine_falls_behind_where_its_scene_says_otherwise() -> None:
    ends = []
    for scene in (None, machine(Shove)):
        place = Shove(scene)
        worlds = TrueWorlds(place, 1, nthread=1)
        worlds.begin(np.arange(1), place.draw([5]))
        for step in range(20):  # a shove of 0.4 s, then nothing
            worlds.step(torch.full((1, 1), 1.0 if step < 8 else 0.0))
        ends.append(float(worlds.coordinates[0][0, 2]))
        worlds.close()
    assert ends[1] > ends[0] + 0.05  # it slides on
