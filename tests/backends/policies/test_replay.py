from __future__ import annotations

import torch
from orbisim_policies.replay import Moments, Replay


def moment(worlds: torch.Tensor, number: int) -> Moments:
    """Observations that say which world and which moment they are of."""
    count = len(worlds)
    view = torch.stack([worlds.float(), torch.full((count,), float(number))], 1)
    flags = torch.zeros(count)
    return Moments(view, view[:, :1], flags + number, flags, flags)


def filled(moments: int, capacity: int) -> Replay:
    replay = Replay(2, capacity, 2, 1, torch.device("cpu"))
    for number in range(moments):
        replay.add(torch.arange(2), moment(torch.arange(2), number))
    return replay


def test_sequences_are_of_one_world_and_follow_each_other() -> None:
    replay = filled(20, 100)
    found = replay.sample(200, 5, torch.rand(2, 200))
    assert found.observation.shape == (5, 200, 2) and found.reward.shape == (5, 200)
    world, number = found.observation.unbind(-1)
    assert torch.equal(world, world[:1].expand_as(world)) and set(world[0].tolist()) == {0.0, 1.0}
    assert torch.equal(number - number[:1], torch.arange(5.0)[:, None].expand(5, 200))
    assert set(number[0].tolist()) == set(map(float, range(16)))  # every place that has room
    assert torch.equal(found.reward, number) and torch.equal(found.action[..., 0], world)


def test_the_oldest_is_forgotten_first() -> None:
    replay = filled(27, 20)  # ten of each world
    found = replay.sample(300, 4, torch.rand(2, 300))
    number = found.observation[..., 1]
    assert set(number.flatten().tolist()) == set(map(float, range(17, 27)))
    assert torch.equal(number - number[:1], torch.arange(4.0)[:, None].expand(4, 300))


def test_worlds_fill_at_their_own_pace() -> None:
    replay = Replay(2, 20, 2, 1, torch.device("cpu"))
    for number in range(4):
        replay.add(torch.tensor([1]), moment(torch.tensor([1]), number))
    assert replay.count.tolist() == [0, 4] and not replay.ready(1)
    replay.add(torch.tensor([0]), moment(torch.tensor([0]), 0))
    assert replay.ready(1) and not replay.ready(2)
