"""The state as the model sees it."""

from __future__ import annotations

import torch
from orbisim_world_model.entities import Entities, choose


def entities(value: float) -> Entities:
    shapes = ((4, 2), (4, 2), (4, 1), (4, 18), (4, 3, 3), (4, 3, 4), (4, 3, 3), (4, 3, 3))
    return Entities(*(torch.full(shape, value) for shape in shapes))


def test_the_hands_parts() -> None:
    x = entities(0.0)._replace(hand=torch.arange(18.0).expand(4, 18))
    assert x.hand_pos[0].tolist() == [0, 1, 2]
    assert x.hand_rot[0].tolist() == [[3, 4, 5], [6, 7, 8], [9, 10, 11]]
    assert x.hand_vel[0].tolist() == [12, 13, 14]
    assert x.hand_ang[0].tolist() == [15, 16, 17]


def test_world_by_world() -> None:
    picked = choose(torch.tensor([True, False, False, True]), entities(1.0), entities(2.0))
    for field in picked:
        assert [float(row.mean()) for row in field] == [1.0, 2.0, 2.0, 1.0]


def test_every_field_is_indexed_and_moved() -> None:
    x = entities(1.0)
    assert all(len(field) == 2 for field in x.at(slice(0, 2)))
    assert all(field.dtype == torch.float64 for field in x.to(torch.float64))
    x.q.requires_grad_()
    assert not x.detach().q.requires_grad
